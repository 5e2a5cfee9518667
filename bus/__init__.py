"""Buses: which node sends when, and in which bytes; imports nothing of ours."""
