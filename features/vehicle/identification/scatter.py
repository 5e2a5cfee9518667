"""Scatter of the scores of a drive, for intervals that hold where errors of the model last."""

import numpy as np


def scatter_of(scores: np.ndarray, lags: int) -> np.ndarray:
    """The covariance (p, p) of the sum of scores (n, p) that correlate over so many samples.

    It is larger by what its own error asks, so that intervals with the quantiles of the normal
    distribution hold in 95 %: one drive tells it to a tenth or two.

    Sources: Newey and West (1987), A simple, positive semi-definite, heteroskedasticity and
    autocorrelation consistent covariance matrix; Kiefer and Vogelsang (2005), A new asymptotic
    theory for heteroskedasticity-autocorrelation robust tests, for the quantile.
    """
    total = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        product = scores[:-lag].T @ scores[lag:]
        total += (1 - lag / (lags + 1)) * (product + product.T)
    share = min(1.0, (lags + 1) / len(scores))
    quantile = np.polyval([-0.5324, 0.4160, 2.9694, 1.9600], share)
    return (quantile / 1.9600) ** 2 * total
