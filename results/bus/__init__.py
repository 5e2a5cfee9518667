"""Frames, load and delays of the bus, from the record of a run."""
