"""Largest ellipsoid: of each direction the sharper belief, in the axes in which both are diagonal.

Source: Benaskeur (2002), Consistent fusion of correlated data sources, IECON, pages 2652 to 2656.
Its ellipsoid lies inside the intersection of both, so it is sharper than covariance intersection,
and overconfident where the errors of both are alike in a direction that both take for their own.

    concord run --scenario oscillator --rule examples/rules/largest_ellipsoid.py:largest_ellipsoid
"""

import numpy as np

from concord.filters.gaussian import Gaussian


def largest_ellipsoid(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Beliefs (..., J, n), the own first, one after the other where weights (..., J) are not 0."""
    mean, cov = beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :]
    for j in range(1, weights.shape[-1]):
        heard = weights[..., j] > 0
        other = Gaussian(
            np.where(heard[..., None], beliefs.mean[..., j, :], mean),
            np.where(heard[..., None, None], beliefs.cov[..., j, :, :], cov),
        )
        mean, cov = pair(Gaussian(mean, cov), other)
    return Gaussian(mean, cov)


def pair(one: Gaussian, other: Gaussian) -> Gaussian:
    """Two beliefs (..., n): axes T with one.cov = T T' and other.cov = T diag(d) T'."""
    root = np.linalg.cholesky(one.cov)
    white = np.linalg.solve(root, np.linalg.solve(root, other.cov).mT)
    d, turn = np.linalg.eigh((white + white.mT) / 2)
    axes = root @ turn
    apart = np.linalg.solve(axes, (other.mean - one.mean)[..., None])[..., 0]
    mean = one.mean + (axes @ np.where(d < 1, apart, 0.0)[..., None])[..., 0]
    return Gaussian(mean, (axes * np.minimum(d, 1.0)[..., None, :]) @ axes.mT)
