"""How sure a Monte Carlo is: intervals over its runs, which are independent of each other.

Steps and nodes of one run are not, so every interval begins with one figure per run. Figures that
cannot be negative (errors, ANEES, bytes) and ratios have intervals of their logarithm, which never
reach below 0. Differences have the plain interval of a mean. Pairs keep the noise that they share.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

RESAMPLES = 999
BATCHES = 10


class Interval(NamedTuple):
    """A figure and the bounds that hold it with the confidence asked for; NaN where unknown."""

    value: float
    low: float
    high: float

    def spread(self, sign: str = "±") -> str:
        """Return half of the width with a sign, or both bounds where one is far from the other;
        empty where they are unknown."""
        if np.isnan(self.low):
            return ""
        if self.high - self.value > 2 * (self.value - self.low):
            return f"({self.low:.2g} to {self.high:.2g})"
        return f"{sign}{(self.high - self.low) / 2:.2g}"


Means = Callable[[np.ndarray], Interval]
Ratios = Callable[[np.ndarray, np.ndarray], Interval]


class IntervalMethod(NamedTuple):
    """A way to make intervals of (runs,) figures of 0 or more: of a mean, and of the ratio of two
    root means."""

    mean: Means
    ratio: Ratios


def mean_t(values: np.ndarray, confidence: float = 0.95) -> Interval:
    """Student's interval of the mean of independent values (runs,); NaN ones are left out."""
    values = values[~np.isnan(values)]
    if not len(values):
        return Interval(np.nan, np.nan, np.nan)
    middle = float(values.mean())
    half = _half_width(len(values), _std(values), confidence)
    return Interval(middle, middle - half, middle + half)


def positive_mean_t(values: np.ndarray, confidence: float = 0.95) -> Interval:
    """Student's interval of the mean of independent values (runs,) of 0 or more, by the delta
    method on its logarithm; NaN ones are left out.

    The bounds are the exponentials of the interval of log m + (x - m) / m. They are those of the
    mean m itself, while the interval of log x would be that of the geometric mean.
    """
    values = values[~np.isnan(values)]
    if not values.any():
        return mean_t(values, confidence)
    middle = values.mean()
    return on_log_scale(float(middle), len(values), _std(values / middle), confidence)


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
    if not others.any():
        return Interval(np.inf, np.nan, np.nan)
    influence = 0.5 * (squares / squares.mean() - others / others.mean())
    return on_log_scale(middle, len(influence), _std(influence), confidence)


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
    "t": IntervalMethod(positive_mean_t, ratio_t),
    "bootstrap": IntervalMethod(mean_bootstrap, ratio_bootstrap),
}


def batch_means(values: np.ndarray, confidence: float = 0.95) -> Interval:
    """The interval of a mean over steps (S,) that depend on each other.

    It is that of the means of `BATCHES` batches of consecutive steps (batch means, Law 2015,
    section 9.5.3); NaN for fewer than two steps a batch.
    """
    known = values[~np.isnan(values)]
    if len(known) < 2 * BATCHES:
        return Interval(float(known.mean()) if len(known) else np.nan, np.nan, np.nan)
    means = np.array([batch.mean() for batch in np.array_split(known, BATCHES)])
    return positive_mean_t(means, confidence)


def root_mean(values: np.ndarray, ratio: Ratios = ratio_t, unit: float = 1.0) -> Interval:
    """The root mean square of values (runs,), as a multiple of a known number."""
    squares = np.square(values)
    return ratio(squares, np.full_like(squares, unit**2))


def on_log_scale(middle: float, count: int, deviation: float, confidence: float = 0.95) -> Interval:
    """Return the interval of a figure of so many runs, whose logarithm is linearised as the mean
    of values with this standard deviation."""
    grown = np.exp(_half_width(count, deviation, confidence))
    return Interval(middle, float(middle / grown), float(middle * grown))


def chi_square_quantile(probability: float, freedoms: np.ndarray | int) -> np.ndarray:
    """Return what a chi-square variable of so many degrees of freedom is below so probably."""
    # scipy.stats has the same, and takes three times as long to load.
    from scipy.special import gammaincinv

    return 2 * gammaincinv(np.asarray(freedoms) / 2, probability)


def _std(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else float("nan")


def _half_width(count: int, deviation: float, confidence: float) -> float:
    if count < 2:
        return float("nan")
    # Only here: scipy takes longer to load than most commands take.
    from scipy.special import stdtrit

    return float(stdtrit(count - 1, 0.5 + confidence / 2) * deviation / np.sqrt(count))


def _both_known(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known = np.isfinite(a) & np.isfinite(b)
    return a[known], b[known]


def _root_ratio(squares: np.ndarray, others: np.ndarray) -> float:
    # A reference without error makes the ratio infinite.
    with np.errstate(divide="ignore"):
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
