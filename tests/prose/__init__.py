"""The rules of prose that a machine can check: openings, lengths, retired names."""
