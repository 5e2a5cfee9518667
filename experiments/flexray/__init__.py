"""What the `concord flexray` commands compute."""
