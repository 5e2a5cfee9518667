"""Frames that the dashboard draws, made from messages and recordings."""
