"""What the `concord topology` commands compute."""
