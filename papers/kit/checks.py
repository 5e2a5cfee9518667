"""Checks: a measured figure against what it must be. A failed check fails the reproduction."""

from collections.abc import Callable

import msgspec
import numpy as np
from scipy.special import stdtrit

from concord.results.figures.intervals import Interval

# A reproduction makes about a hundred checks; one in ten such reports may fail by chance.
CONFIDENCE = 0.999


class Check(msgspec.Struct, frozen=True):
    """An assertion that must hold: what was expected, in words, and what was measured."""

    name: str
    expected: str
    measured: float | str
    ok: bool


def near(name: str, measured: float, expected: float, tolerance: float, unit: str = "") -> Check:
    """|measured - expected| <= tolerance; a measured NaN fails."""
    words = f"{expected:g} ± {tolerance:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(abs(measured - expected) <= tolerance))


def at_most(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured <= bound."""
    words = f"at most {bound:.10g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured <= bound))


def above(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured > bound."""
    words = f"above {bound:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured > bound))


def below(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured < bound."""
    words = f"below {bound:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured < bound))


def agrees(
    name: str, measured: Interval, runs: int, expected: float, *,
    of_runs: int | None = None, rounding: float = 0.0,
) -> Check:  # fmt: skip
    """The expected value is what so many runs allow, by their own 95 % interval.

    Args:
        measured: the mean of the runs with its interval.
        runs: how many runs the interval is of.
        of_runs: how many runs the expected value is the mean of; None if it is exact.
        rounding: half of the last digit that the expected value has.
    """
    widened = stdtrit(runs - 1, 0.5 + CONFIDENCE / 2) / stdtrit(runs - 1, 0.975)
    scatter = np.sqrt(1.0 + (0.0 if of_runs is None else runs / of_runs))
    half_width = (measured.high - measured.low) / 2
    return near(name, measured.value, expected, float(widened * scatter * half_width + rounding))


def refused(name: str, attempt: Callable[[], object], because: str) -> Check:
    """`attempt` raises a ValueError that says `because`."""
    try:
        attempt()
    except ValueError as error:
        return Check(name, f"refused: {because}", str(error), because in str(error))
    return Check(name, f"refused: {because}", "accepted", False)
