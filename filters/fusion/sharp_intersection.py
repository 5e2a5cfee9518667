"""Covariance intersection with weights that go to the sharper beliefs of a neighbourhood."""

from typing import NamedTuple

import numpy as np

from concord.filters.fusion.averaging import Directly, Fused, covariance_intersection
from concord.filters.fusion.hold import check_weights, inverse_volume, times_inverse_volume
from concord.filters.gaussian import Gaussian, joined
from concord.filters.linalg import inverse_spd, multiply

# Many more steps would give some neighbours all the weight, and others none.
_STEPS = 5


class SharpIntersection(NamedTuple):
    """`covariance_intersection` after five steps w_j <- w_j tr(P P_j^-1) / n of the weights.

    P is the fused covariance with the weights of the step before. A belief gains weight if it knows
    more than the fused one. It is an `Averaged`.

    Promises: consistent under the condition of `covariance_intersection`, as the weights follow
    from covariances alone. Each step lowers |P| or leaves it, so |P| is never greater than that of
    `covariance_intersection` with the same weights at the start. Equal covariances keep the
    weights. The units of the state have no effect.

    Fails: as `covariance_intersection`. With nonlinear models a node that errs and does not know it
    gains weight (docs/which_rule_when.md).

    Sources: the step is that of Titterington (1976), Algorithms for computing D-optimal designs.
    Yu (2010), Annals of Statistics 38(3), proves that it is monotonic. The determinant as aim is of
    Julier and Uhlmann (1997).
    """

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool
    ) -> Fused:
        """Implement `Averaged.fuse`; the weights of the result are those after the steps."""
        covs = joined(own, others).cov
        if by_inverse_volume:
            weights = times_inverse_volume(weights, inverse_volume(covs))
        average = Directly(covariance_intersection)
        return average.fuse(own, others, sharpened(covs, weights), False)


def sharpened(covs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weights (..., J) after the steps, for covariances (..., J, n, n).

    Entries of weight zero may be anything, NaN included.

    Raises:
        ValueError: a weight is negative, or they do not sum to 1.
    """
    check_weights(weights)
    states = covs.shape[-1]
    unused = (weights == 0)[..., None, None]
    if unused.any():
        covs = np.where(unused, np.eye(states), covs)
    information = inverse_spd(covs)
    # With rows of all entries, both sums are products of one matrix and one vector.
    rows = information.reshape(*information.shape[:-2], states * states)
    for _ in range(_STEPS):
        average = multiply(rows.mT, weights)
        fused = inverse_spd(average.reshape(*average.shape[:-1], states, states))
        weights = weights * multiply(rows, fused.reshape(average.shape)) / states
    # Their sum is 1 but for rounding.
    return weights / weights.sum(axis=-1, keepdims=True)
