"""Checks of `concord doctor`."""
