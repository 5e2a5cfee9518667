"""Criterion of a set filter: the trace of the shape matrix, with a weight for each state.

A plain trace adds squared metres to squared radians, so its optimum depends on the units. Any
other choice is as sound: the criterion chooses among sets that all hold the state.
"""

from collections.abc import Callable

import numpy as np

Criterion = Callable[[np.ndarray], np.ndarray]
"""Half-widths (..., n) of the set before it is cut -> weights (..., n) of the states."""


def unit_free(half_widths: np.ndarray) -> np.ndarray:
    """One over each half-width: a state counts by what part of it is left, in any unit."""
    return 1.0 / np.where(half_widths > 0.0, half_widths, 1.0)


def plain_trace(half_widths: np.ndarray) -> np.ndarray:
    """One for every state: the trace as printed in papers, in the units of the states."""
    return np.ones(half_widths.shape)
