"""Tests of normalised innovations: their mean, their variance, and whether they are white.

The innovations of a filter whose model is right are white, with mean 0 and the covariance that the
filter states. Sources: Mehra (1970), On the identification of variances and adaptive Kalman
filtering; Bar-Shalom, Li and Kirubarajan (2001), section 5.4; Ljung and Box (1978), On a measure of
lack of fit in time series models.
"""

from typing import NamedTuple

import numpy as np

from concord.results.figures.intervals import Interval, chi_square_quantile, mean_t

LEAST_UPDATES, LEAST_SERIES = 8, 50
"""A channel with fewer updates is not tested, and with fewer than the second not for whiteness.
Student's t and chi-square are exact for few samples; the law of Ljung and Box is one of many."""
_FAR = 6.0
"""Robust standard deviations from the median. Of normal innovations 2 in 10^9 lie beyond it."""
MOST_LAGS = 10
_BATCHES = 10


class ChannelTest(NamedTuple):
    """Tests of one channel; p values are NaN below `LEAST_UPDATES`.

    Attributes:
        updates: how many innovations there are.
        nis: mean square of the normalised innovations, with its 95 % interval; 1 is right.
        mean: of the innovations in units of the channel, with its 95 % interval; 0 is right.
        shift: mean of the normalised innovations.
        spread: their variance about that mean; 1 is right.
        correlation: of successive normalised innovations; 0 is right.
        p_mean, p_spread, p_white: how likely figures so far off are by chance: of the mean by
            Student's t, of the spread by chi-square, of the correlations by Ljung and Box.
        far: how many are so far from the others that no normal noise puts them there.
        core: variance of the others.
    """

    updates: int
    nis: Interval
    mean: Interval
    shift: float
    spread: float
    correlation: float
    p_mean: float
    p_spread: float
    p_white: float
    far: int = 0
    core: float = np.nan


def channel_test(innovations: np.ndarray, variances: np.ndarray) -> ChannelTest:
    """Test the innovations (R, S) of a channel in R runs, NaN where none was taken, with their
    variances (R, S)."""
    normalised = innovations / np.sqrt(variances)
    series = [row[np.isfinite(row)] for row in normalised]
    values = np.concatenate(series)
    updates = len(values)
    if updates < LEAST_UPDATES:
        unknown = Interval(np.nan, np.nan, np.nan)
        known = Interval(float(np.mean(values**2)), np.nan, np.nan) if updates else unknown
        nan = np.nan
        return ChannelTest(updates, known, unknown, nan, nan, nan, nan, nan, nan)
    # Only here: scipy takes longer to load than most commands take.
    from scipy.special import chdtr, chdtrc

    shift = float(values.mean())
    squares = float(((values - shift) ** 2).sum())
    p_spread = 2 * min(chdtr(updates - 1, squares), chdtrc(updates - 1, squares))
    correlation, p_white = _whiteness([row - shift for row in series])
    return ChannelTest(
        updates,
        nis_interval(float((values**2).sum()), updates),
        mean_t(innovations[np.isfinite(normalised)]),
        shift,
        squares / (updates - 1),
        correlation,
        _p_of_mean(values, p_white),
        float(p_spread),
        p_white,
        *_far_ones(values),
    )


def _far_ones(values: np.ndarray) -> tuple[int, float]:
    """How many values (K,) are outliers, and the variance of the others."""
    low, middle, high = np.percentile(values, (25, 50, 75))
    # The quartiles of a normal law are 1.349 standard deviations apart.
    far = np.abs(values - middle) > _FAR * (high - low) / 1.349
    return int(far.sum()), float(values[~far].var())


def nis_interval(total: float, freedoms: int, confidence: float = 0.95) -> Interval:
    """The mean of normalised innovations squared that sum up to `total`, per degree of freedom.

    The interval is that of a variance: total / chi-square quantiles of so many degrees of freedom.
    """
    tail = (1 - confidence) / 2
    low, high = (chi_square_quantile(part, freedoms) for part in (1 - tail, tail))
    return Interval(total / freedoms, float(total / low), float(total / high))


def _p_of_mean(values: np.ndarray, p_white: float) -> float:
    """Two-sided p value of the mean (K,) by Student's t; of batch means where the values are
    probably not white."""
    from scipy.special import stdtr

    if p_white < 0.05:
        values = np.array([batch.mean() for batch in np.array_split(values, _BATCHES)])
    error = values.std(ddof=1) / np.sqrt(len(values))
    if error == 0:
        return 1.0 if values.mean() == 0 else 0.0
    return float(2 * stdtr(len(values) - 1, -abs(values.mean()) / error))


def _whiteness(series: list[np.ndarray]) -> tuple[float, float]:
    """The correlation at lag 1, and the p value of Ljung and Box, of runs without their mean."""
    from scipy.special import chdtrc

    squares = sum(float((row**2).sum()) for row in series)
    statistic, freedoms, products = 0.0, 0, 0.0
    if sum(map(len, series)) < LEAST_SERIES:
        return np.nan, np.nan
    for row in series:
        n, energy = len(row), float((row**2).sum())
        lags = min(MOST_LAGS, n // 5)
        if not lags or energy == 0:
            continue
        sums = np.array([float(row[:-lag] @ row[lag:]) for lag in range(1, lags + 1)])
        products += sums[0]
        statistic += n * (n + 2) * ((sums / energy) ** 2 / (n - np.arange(1, lags + 1))).sum()
        freedoms += lags
    if not freedoms:
        return np.nan, np.nan
    return float(products / squares), float(chdtrc(freedoms, statistic))
