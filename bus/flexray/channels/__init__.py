"""Channels A and B: which frames each carries, and the slot counters of each."""
