"""Filters that learn the noise of their sensors."""
