"""Expected errors of a run, computed elsewhere from other runs of the same scenario."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dashboard.frames.frame import Array


class Expected(NamedTuple):
    """At some times (T,): the band of the nodes' mean NEES, and the least error that there can be
    of a filter that hears everything; NaN where it is unknown."""

    nees_low: Array
    nees_high: Array
    bound: Array


Expectation = Callable[[Array], Expected]
"""(times (T,)) -> what is to be expected at them."""


def nothing_expected(times: Array) -> Expected:
    """Return an expectation without values, for a run whose values are not computed."""
    unknown = np.full(len(times), np.nan)
    return Expected(unknown, unknown, unknown)
