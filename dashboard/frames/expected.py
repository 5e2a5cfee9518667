"""Expected errors of a run, computed elsewhere from other runs of the same scenario."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Expected(NamedTuple):
    """At some times (T,): the band of the nodes' mean NEES, and the least error that there can be
    of a filter that hears everything; NaN where it is unknown."""

    nees_low: np.ndarray
    nees_high: np.ndarray
    bound: np.ndarray


Expectation = Callable[[np.ndarray], Expected]
"""(times (T,)) -> what is to be expected at them."""


def nothing_expected(times: np.ndarray) -> Expected:
    """Return an expectation without values, for a run whose values are not computed."""
    unknown = np.full(len(times), np.nan)
    return Expected(unknown, unknown, unknown)
