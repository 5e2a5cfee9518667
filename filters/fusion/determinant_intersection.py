"""Covariance intersection of two beliefs with the weight that leaves the least determinant."""

import numpy as np

from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky

# A slope of log det that the rounding of a belief to float32 gives as well.
_ROUNDING = 1e-6
# Halvings of the interval of the weight: beyond the last bit of a double.
_HALVINGS = 60


def determinant_intersection(own: Gaussian, other: Gaussian) -> Gaussian:
    """The belief w of own and 1 - w of other with the largest log det(w P1^-1 + (1 - w) P2^-1).

    Promises: consistent if both beliefs are, however their errors are correlated, as
    `covariance_intersection` is for any weight. A belief to which the other adds nothing (log det
    grows by less than 1e-6) comes back bit for bit, so equal beliefs fuse to themselves.

    Fails: the determinant may shrink along one direction while another grows. The promise assumes
    covariances that do not depend on the errors.

    Source: Julier and Uhlmann (1997), A non-divergent estimation algorithm in the presence of
    unknown correlations. With e the eigenvalues of P1 P2^-1 the derivative by w is
    sum (1 - e) / (w + (1 - w) e), which falls with w.

    Args:
        own, other: mean (..., n), cov (..., n, n).

    Returns:
        mean (..., n), cov (..., n, n); NaN in a lane with a covariance that is not positive
        definite.
    """
    eigenvalues = _relative_eigenvalues(own.cov, other.cov)
    weight = _best_weight(eigenvalues)
    weights = np.stack([weight, 1.0 - weight], axis=-1)
    pair = Gaussian(
        np.stack(np.broadcast_arrays(own.mean, other.mean), axis=-2),
        np.stack(np.broadcast_arrays(own.cov, other.cov), axis=-3),
    )
    fused = covariance_intersection(pair, weights)
    return _chosen(weight == 1.0, own, _chosen(weight == 0.0, other, fused))


def _relative_eigenvalues(own_cov: np.ndarray, other_cov: np.ndarray) -> np.ndarray:
    """Eigenvalues (..., n) of P1 P2^-1; NaN in a lane that has none."""
    whitener = np.linalg.inv(cholesky(other_cov))
    relative = whitener @ own_cov @ whitener.mT
    sound = np.isfinite(relative).all(axis=(-1, -2), keepdims=True)
    values = np.linalg.eigvalsh(np.where(sound, relative, np.eye(relative.shape[-1])))
    positive = np.logical_and(sound[..., 0], values[..., :1] > 0)  # pyright: ignore[reportIndexIssue]
    return np.where(positive, values, np.nan)


def _best_weight(eigenvalues: np.ndarray) -> np.ndarray:
    """The weight (...) of the own belief, 0 to 1; NaN where the eigenvalues (..., n) are."""

    def slope(weight: np.ndarray) -> np.ndarray:
        share = weight[..., None]
        return ((1 - eigenvalues) / (share + (1 - share) * eigenvalues)).sum(axis=-1)

    low, high = np.zeros(eigenvalues.shape[:-1]), np.ones(eigenvalues.shape[:-1])
    keep, yield_ = slope(high) >= -_ROUNDING, slope(low) <= 0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        rising = slope(middle) > 0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    weight = np.where(keep, 1.0, np.where(yield_, 0.0, 0.5 * (low + high)))
    return np.where(np.isnan(eigenvalues).any(axis=-1), np.nan, weight)


def _chosen(where: np.ndarray, left: Gaussian, right: Gaussian) -> Gaussian:
    return Gaussian(
        np.where(where[..., None], left.mean, right.mean),
        np.where(where[..., None, None], left.cov, right.cov),
    )
