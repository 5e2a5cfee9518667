"""Faster ways through the unscented transform, by the size of the batch."""
