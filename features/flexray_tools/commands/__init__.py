"""Computations of the `concord flexray` commands."""
