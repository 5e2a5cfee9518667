"""The command for several targets."""
