"""Signals in frames: where a description says that they stand, and their values in a log."""
