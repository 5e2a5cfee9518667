"""Fusion rules with one mistake each, for the tests of `concord check`."""

import numpy as np

from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import inverse_spd


def _without_unheard(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    heard = weights > 0
    n = beliefs.mean.shape[-1]
    return Gaussian(
        np.where(heard[..., None], beliefs.mean, 0.0),
        np.where(heard[..., None, None], beliefs.cov, np.eye(n)),
    )


def _from_information(matrix: np.ndarray, vector: np.ndarray) -> Gaussian:
    cov = inverse_spd(matrix)
    return Gaussian((cov @ vector[..., None])[..., 0], 0.5 * (cov + cov.mT))


def order_dependence(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Fuse the neighbours one after the other, each with half the weight."""
    mean, cov = _without_unheard(beliefs, weights)
    result = Gaussian(mean[..., 0, :], cov[..., 0, :, :])
    for j in range(1, weights.shape[-1]):
        share = np.where(weights[..., j] > 0, 0.5, 0.0)
        pair = Gaussian(
            np.stack((result.mean, mean[..., j, :]), axis=-2),
            np.stack((result.cov, cov[..., j, :, :]), axis=-3),
        )
        result = covariance_intersection(pair, np.stack((1 - share, share), axis=-1))
    return result


def mixed_lanes(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Normalise the weights over all lanes instead of over each one."""
    mean, cov = _without_unheard(beliefs, weights)
    share = (weights / weights.sum())[..., None, None]
    matrix = inverse_spd(cov)
    vector = (matrix @ mean[..., None])[..., 0]
    return _from_information((share * matrix).sum(-3), (share[..., 0] * vector).sum(-2))


def double_counting(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Add the informations, as if errors were independent."""
    mean, cov = _without_unheard(beliefs, weights)
    heard = (weights > 0)[..., None, None]
    matrix = np.where(heard, inverse_spd(cov), 0.0)
    vector = (matrix @ mean[..., None])[..., 0]
    return _from_information(matrix.sum(-3), vector.sum(-2))


def nan_leak(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Multiply an unheard neighbour's belief by 0, which leaves NaN."""
    share = weights[..., None, None]
    matrix = inverse_spd(beliefs.cov)
    vector = (matrix @ beliefs.mean[..., None])[..., 0]
    return _from_information((share * matrix).sum(-3), (share[..., 0] * vector).sum(-2))


def overconfidence(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Halve the covariance of covariance intersection."""
    mean, cov = covariance_intersection(beliefs, weights)
    return Gaussian(mean, 0.5 * cov)


def wrong_shape(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Return the own belief with the axis of neighbours."""
    return Gaussian(beliefs.mean[..., :1, :], beliefs.cov[..., :1, :, :])


def without_lanes(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Index the neighbours by the first axis; that of a single lane."""
    if weights.ndim > 1:
        raise IndexError("too many axes")
    return Gaussian(beliefs.mean[0], beliefs.cov[0])


NOT_A_RULE = 3
