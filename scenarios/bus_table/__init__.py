"""Buses as the table of buses has them."""
