"""Explanations of the page: help, tooltips, and the shares that made a number."""
