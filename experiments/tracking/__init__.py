"""Tracks of several targets in a run: their scores, their place in run.nc, and their figures."""
