"""Clocks of a FlexRay cluster."""
