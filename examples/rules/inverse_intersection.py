"""Inverse covariance intersection: less cautious than covariance intersection, and consistent where
both beliefs share some information, whatever that is.

Source: Noack, Sijs, Reinhardt and Hanebeck (2017), Decentralized data fusion with inverse
covariance intersection, Automatica 79, pages 35 to 41, equations (11) and (12).

    concord run --scenario oscillator --rule examples/rules/inverse_intersection.py:inverse
"""

import numpy as np

from concord.filters.gaussian import Gaussian

_WEIGHTS = np.linspace(0.02, 0.98, 25)


def inverse(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Beliefs (..., J, n), the own first, one after the other where weights (..., J) are not 0."""
    mean, cov = beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :]
    for j in range(1, weights.shape[-1]):
        heard = weights[..., j] > 0
        there = np.where(heard[..., None, None], beliefs.cov[..., j, :, :], cov)
        fused = pair(Gaussian(mean, cov), Gaussian(beliefs.mean[..., j, :], there))
        mean = np.where(heard[..., None], fused.mean, mean)
        cov = np.where(heard[..., None, None], fused.cov, cov)
    return Gaussian(mean, cov)


def pair(one: Gaussian, other: Gaussian) -> Gaussian:
    """Two beliefs (..., n), with the weight of least volume on a grid."""
    shape = (-1, *(1,) * one.cov.ndim)
    w = _WEIGHTS.reshape(shape)
    own, theirs = np.linalg.inv(one.cov), np.linalg.inv(other.cov)
    common = np.linalg.inv(w * one.cov + (1 - w) * other.cov)
    information = own + theirs - common
    best = np.argmax(np.linalg.slogdet(information)[1], axis=0)
    w = _WEIGHTS[best][..., None, None]
    common = np.take_along_axis(common, best[None, ..., None, None], axis=0)[0]
    cov = np.linalg.inv(own + theirs - common)
    gain, other_gain = cov @ (own - w * common), cov @ (theirs - (1 - w) * common)
    mean = (gain @ one.mean[..., None] + other_gain @ other.mean[..., None])[..., 0]
    return Gaussian(mean, (cov + cov.mT) / 2)
