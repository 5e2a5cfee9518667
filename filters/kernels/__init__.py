"""A faster way through algebra with small matrices, for many lanes."""
