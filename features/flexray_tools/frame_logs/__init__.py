"""Logs of frames: captures, tables of frames, and what they tell of a bus."""
