"""Why a lane of a filter is not a number."""

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky
from filters.update import Update


def failures(before: Gaussian, measurement: np.ndarray, update: Update[Gaussian]) -> np.ndarray:
    """What went wrong in each lane of an update, in words (...); empty where all is finite.

    The first cause found is named: the belief that came in, the reading, what the model predicted,
    and the innovation covariance.

    Args:
        before: the belief at the beginning of the step (before a prediction, if there was one),
            mean (..., n), cov (..., n, n).
        measurement: (..., m), as it was given.
        update: what came of it, from any filter.
    """
    fine = _finite(update.belief)
    taken = ~np.isnan(measurement)
    expected = np.diagonal(update.innovation_cov, axis1=-2, axis2=-1)
    causes = {
        "the belief before was not finite": ~_finite(before),
        "the state covariance is not positive definite: add process noise, or a wider prior": (
            ~_definite(before.cov)
        ),
        "a reading is infinite: pass NaN for one that was not taken": (
            np.isinf(measurement).any(axis=-1)
        ),
        "the predicted reading is not finite: the model, or an inner filter, has failed": (
            taken & ~np.isfinite(expected)
        ).any(axis=-1),
        "the innovation covariance is not positive definite: give every channel some noise": (
            ~_definite(_without_untaken(update.innovation_cov))
        ),
    }
    words = np.full(np.shape(fine), "", dtype=object)
    words[~fine] = "the update has no solution: give every channel some noise"
    for cause, holds in reversed(causes.items()):
        words = np.where(~fine & holds, cause, words)
    return words


def _finite(belief: Gaussian) -> np.ndarray:
    finite_mean = np.isfinite(belief.mean).all(axis=-1)
    return np.logical_and(finite_mean, np.isfinite(belief.cov).all(axis=(-1, -2)))


def _definite(cov: np.ndarray) -> np.ndarray:
    return np.asarray(np.isfinite(cholesky(cov)).all(axis=(-1, -2)))


def _without_untaken(innovation_cov: np.ndarray) -> np.ndarray:
    """Unit variances in the rows of readings that were not taken, which are NaN throughout."""
    untaken = np.asarray(np.isnan(innovation_cov).all(axis=-1))
    either = untaken[..., :, None] | untaken[..., None, :]
    return np.where(either, np.eye(innovation_cov.shape[-1]), innovation_cov)
