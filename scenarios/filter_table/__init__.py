"""Filters as the table of filters has them."""
