"""What the page says about itself: help, tooltips, and what made a number."""
