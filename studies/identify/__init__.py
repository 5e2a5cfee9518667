"""Noise, delays and parameters that explain the readings of a scenario best."""
