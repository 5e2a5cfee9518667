"""Timing beside a peer or a floor in the same run; never part of a result."""

import os

# Figures are of one core, and threads that wait for small matrices only burn another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
