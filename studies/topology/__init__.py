"""Computations of the `concord topology` commands."""
