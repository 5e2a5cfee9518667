"""Sums of floating-point numbers without rounding: any order and any grouping give the same bits.

Each number is split at fixed binary places into parts of 32 bits, and integers add the parts place
by place. Source: the small superaccumulator of Neal (2015), "Fast exact summation using small and
large superaccumulators", arXiv:1505.05571. The places here are never carried: the sums of fewer
than `MOST_TERMS` numbers fit into 64 bits. Bits below 2**-LOWEST_BIT are left out of each number.
"""

from functools import reduce
from typing import NamedTuple

import numpy as np

PLACE_BITS = 32
# The lowest bit of place p is 2**(32 * p - LOWEST_BIT).
LOWEST_BIT = 992
SCALE = 1 << LOWEST_BIT
MOST_TERMS = 2**30
MOST_AT_ONCE = 2**20
# Rows whose parts stay in the caches of a processor while they are taken apart.
_CACHED = 64


class ExactSums(NamedTuple):
    """Sums of C columns: `parts` (P, C) of 64-bit integers, from place `lowest` upwards."""

    lowest: int
    parts: np.ndarray

    @property
    def integers(self) -> np.ndarray:
        """Return the sums times `SCALE` as (C,) Python integers."""
        total = np.zeros(self.parts.shape[1], dtype=object)
        for place, part in enumerate(self.parts, start=self.lowest):
            total += part.astype(object) * (1 << (PLACE_BITS * place))
        return total


def exact_sums(values: np.ndarray) -> ExactSums:
    """Return the sums of finite values (R, C) over R, of 1 to `MOST_AT_ONCE`."""
    assert len(values) <= MOST_AT_ONCE, "pieces have fewer runs"
    blocks = range(0, len(values), _CACHED)
    return reduce(added, (_sums_of_block(values[first : first + _CACHED]) for first in blocks))


def _sums_of_block(values: np.ndarray) -> ExactSums:
    highest = (int(np.frexp(np.abs(values).max())[1]) - 1 + LOWEST_BIT) // PLACE_BITS
    rest, parts = np.array(values, dtype=float), []
    for place in range(max(highest, 0), -1, -1):
        unit = 2.0 ** (PLACE_BITS * place - LOWEST_BIT)
        whole = np.trunc(rest * (1 / unit))
        # At most 2**20 integers of 32 bits: no sum of them is rounded.
        parts.insert(0, whole.sum(axis=0).astype(np.int64))
        rest -= whole * unit
        if not rest.any():
            return ExactSums(place, np.array(parts))
    return ExactSums(0, np.array(parts))


def added(one: ExactSums, other: ExactSums) -> ExactSums:
    """Return the sums of both together."""
    lowest = min(one.lowest, other.lowest)
    places = max(one.lowest + len(one.parts), other.lowest + len(other.parts)) - lowest
    parts = np.zeros((places, one.parts.shape[1]), dtype=np.int64)
    for sums in (one, other):
        start = sums.lowest - lowest
        parts[start : start + len(sums.parts)] += sums.parts
    return ExactSums(lowest, parts)


def quotient(numerator: int, denominator: int) -> float:
    """Return the quotient, rounded once; NaN for a denominator of 0, infinite beyond the range."""
    if denominator == 0:
        return float("nan")
    try:
        return numerator / denominator
    except OverflowError:
        return float("inf") if (numerator > 0) == (denominator > 0) else float("-inf")
