"""Rules that fuse the beliefs of several nodes whose errors are correlated in an unknown way."""

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import inverse_spd, multiply, symmetrise


def weighted_average(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Weighted averages of means and of covariances ("WAC"): x = sum w_j x_j, P = sum w_j P_j.

    Promises: if every P_j bounds its node's error covariance, P bounds the fused one, however the
    errors are correlated, because (sum w e)(sum w e)' <= sum w e e' (Jensen). Needs no inverse, so
    singular covariances pass.

    Fails: it is never tighter than `covariance_intersection`, and a node that sees nothing keeps
    its vote. On an unstable plant the network diverges even though some nodes see everything: with
    a scalar plant F, weight matrix Pi, L rounds a step and D = diag(1 for blind nodes, 0 for nearly
    perfect sensors), the mean if |F| rho(Pi^L D) > 1 and the covariance if F^2 rho(Pi^L D) > 1. The
    promise assumes weights that do not depend on the errors.

    Source: Widjiantoro et al., weighted-average consensus UKF, step beta 3.

    Args:
        beliefs: mean (..., J, n), cov (..., J, n, n). Entries of weight zero may be anything, NaN
            included.
        weights: (..., J), not negative, sum 1.

    Returns:
        mean (..., n), cov (..., n, n).

    Raises:
        ValueError: a weight is negative, or they do not sum to 1.
    """
    check_weights(weights)
    mean, cov = _without_unweighted(beliefs, weights)
    return Gaussian(multiply(mean.mT, weights), (weights[..., None, None] * cov).sum(axis=-3))


def covariance_intersection(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Weighted averages of information ("CI"): P^-1 = sum w_j P_j^-1, P^-1 x = sum w_j P_j^-1 x_j.

    Promises: consistent under the same condition as `weighted_average`, and never less tight, since
    the inverse is operator convex: P_CI <= P_WAC. A node that sees nothing loses its vote as its
    covariance grows, so the fused belief stays bounded where the average diverges.

    Fails: it gains nothing from errors that are in fact independent (equal beliefs give the same
    belief back), and a lane with a covariance of positive weight that is not positive definite is
    NaN. The promise assumes weights that do not depend on the errors.

    Sources: Julier and Uhlmann (1997), A non-divergent estimation algorithm in the presence of
    unknown correlations; Battistelli and Chisci (2014), Kullback-Leibler average.

    Args, returns and raises as `weighted_average`.
    """
    check_weights(weights)
    mean, cov = _without_unweighted(beliefs, weights)
    share = weights[..., None, None] * inverse_spd(cov)
    fused_cov = inverse_spd(symmetrise(share.sum(axis=-3)))
    # Averaging differences to the first mean, not means, spares their digits.
    first = mean[..., 0, :]
    pull = multiply(share, mean - first[..., None, :]).sum(axis=-2)
    return Gaussian(first + multiply(fused_cov, pull), fused_cov)


def check_weights(weights: np.ndarray) -> None:
    """Refuse weights (..., J) that are not averages; NaN passes, for it marks a failed lane.

    Raises:
        ValueError: a weight is negative, or they do not sum to 1 within 1e-9.
    """
    total = weights.sum(axis=-1)
    if (weights < 0).any() or (np.abs(total - 1) > 1e-9).any():
        raise ValueError(
            f"weights must be non-negative and sum to 1 over the last axis, but the least is "
            f"{np.nanmin(weights)} and the sums span {np.nanmin(total)} to {np.nanmax(total)}: "
            "normalise them, for instance with hold.renormalise"
        )


def _without_unweighted(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Harmless stand-ins for entries of weight zero, which 0 * NaN would let through."""
    unused = weights == 0
    if not unused.any():
        return beliefs
    n = beliefs.mean.shape[-1]
    return Gaussian(
        np.where(unused[..., None], 0.0, beliefs.mean),
        np.where(unused[..., None, None], np.eye(n), beliefs.cov),
    )
