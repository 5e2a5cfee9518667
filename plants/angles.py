"""Angles on the circle."""

import math

import numpy as np
from numpy.typing import NDArray

TURN = 2 * math.pi


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same angles (...) in rad, within (-pi, pi]."""
    # The minimum takes back one unit in the last place that rounding may add to pi.
    return np.minimum(angle - TURN * np.ceil(angle / TURN - 0.5), math.pi)
