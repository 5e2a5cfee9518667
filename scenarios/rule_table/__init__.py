"""Fusion rules as the table of rules has them."""
