"""Faults as data: their vocabulary, and what they do to sensors, senders and links."""
