"""How sure a Monte Carlo is: intervals over its runs, which are independent of each other.

Steps and nodes of one run are not, so every interval begins with one figure per run. A `Statistic`
is the exponential of half of `log mean a - log mean b` for ratios of root mean squares, and the
plain mean for everything else; pairs keep the noise that they share.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

RESAMPLES = 999


class Interval(NamedTuple):
    """A figure and the bounds that hold it with the confidence asked for; NaN where unknown."""

    value: float
    low: float
    high: float


Means = Callable[[np.ndarray], Interval]
Ratios = Callable[[np.ndarray, np.ndarray], Interval]


class IntervalMethod(NamedTuple):
    """A way to make intervals of (runs,) figures: of a mean, and of the ratio of two root means."""

    mean: Means
    ratio: Ratios


def mean_t(values: np.ndarray, confidence: float = 0.95) -> Interval:
    """Student's interval of the mean of independent values (runs,); NaN ones are left out."""
    values = values[~np.isnan(values)]
    if not len(values):
        return Interval(np.nan, np.nan, np.nan)
    middle = float(values.mean())
    half = _half_width(values, confidence)
    return Interval(middle, middle - half, middle + half)


def ratio_t(squares: np.ndarray, others: np.ndarray, confidence: float = 0.95) -> Interval:
    """sqrt(mean squares / mean others) of paired values (runs,), by the delta method.

    Source: Student's interval of the linearised logarithm; Casella and Berger (2002), Statistical
    Inference, section 5.5.4. Noise that both share cancels in the pairs.
    """
    squares, others = _both_known(squares, others)
    if not len(squares):
        return Interval(np.nan, np.nan, np.nan)
    if not squares.any():
        return Interval(0.0, 0.0, 0.0)
    middle = _root_ratio(squares, others)
    influence = 0.5 * (squares / squares.mean() - others / others.mean())
    grown = np.exp(_half_width(influence, confidence))
    return Interval(middle, float(middle / grown), float(middle * grown))


def mean_bootstrap(values: np.ndarray, confidence: float = 0.95) -> Interval:
    """Bootstrap interval (bias corrected and accelerated) of the mean of values (runs,)."""
    values = values[~np.isnan(values)]
    if len(values) < 2 or np.ptp(values) == 0:
        return mean_t(values, confidence)
    low, high = _bootstrap((values,), lambda v, axis: v.mean(axis), confidence)
    return Interval(float(values.mean()), low, high)


def ratio_bootstrap(squares: np.ndarray, others: np.ndarray, confidence: float = 0.95) -> Interval:
    """Bootstrap interval of sqrt(mean squares / mean others) of paired values (runs,)."""
    squares, others = _both_known(squares, others)
    if len(squares) < 2 or np.ptp(squares / others) == 0:
        return ratio_t(squares, others, confidence)
    low, high = _bootstrap((squares, others), _root_ratio_along, confidence)
    return Interval(_root_ratio(squares, others), low, high)


METHODS: dict[str, IntervalMethod] = {
    "t": IntervalMethod(mean_t, ratio_t),
    "bootstrap": IntervalMethod(mean_bootstrap, ratio_bootstrap),
}


def _half_width(values: np.ndarray, confidence: float) -> float:
    if len(values) < 2:
        return float("nan")
    quantile = stdtrit(len(values) - 1, 0.5 + confidence / 2)
    return float(quantile * values.std(ddof=1) / np.sqrt(len(values)))


def _both_known(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known = np.isfinite(a) & np.isfinite(b)
    return a[known], b[known]


def _root_ratio(squares: np.ndarray, others: np.ndarray) -> float:
    return float(np.sqrt(squares.mean() / others.mean()))


def _root_ratio_along(squares: np.ndarray, others: np.ndarray, axis: int) -> np.ndarray:
    return np.sqrt(squares.mean(axis) / others.mean(axis))


def _bootstrap(
    samples: tuple[np.ndarray, ...], statistic: Callable[..., np.ndarray], confidence: float
) -> tuple[float, float]:
    # Loading it takes longer than most of what is done here.
    from scipy import stats

    # The seed is fixed: the same runs give the same interval.
    found = stats.bootstrap(
        samples, statistic, n_resamples=RESAMPLES, paired=True, confidence_level=confidence,
        method="BCa", vectorized=True, rng=np.random.default_rng(np.random.SeedSequence(0)),
    )  # fmt: skip
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
