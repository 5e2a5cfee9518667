"""Covariance intersection with weights that go to the sharper beliefs of a neighbourhood."""

from typing import NamedTuple

import numpy as np

from concord.filters.fusion.averaging import Fused, near_sharpest
from concord.filters.fusion.hold import (
    check_weights,
    inverse_volume_of_factor,
    times_inverse_volume,
)
from concord.filters.gaussian import Gaussian, Information, to_gaussian
from concord.filters.linalg import factor_and_inverse, inverse_spd, lanes_last, symmetrise

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
        # With the axis of neighbours first, sums over it are passes along the lanes.
        means = np.concatenate((own.mean[None], _neighbours_first(others.mean, -2)))
        covs = np.concatenate((own.cov[None], _neighbours_first(others.cov, -3)))
        factor, information = factor_and_inverse(covs)
        inverse_volume = _neighbours_last(inverse_volume_of_factor(factor), -1)
        if by_inverse_volume:
            weights = times_inverse_volume(weights, inverse_volume)
        else:
            weights = np.broadcast_to(weights, inverse_volume.shape)
        check_weights(weights)
        w = np.ascontiguousarray(_neighbours_first(weights, -1))
        if np.count_nonzero(w) < w.size:
            # A product of 0 and NaN is NaN.
            unused = (w == 0)[..., None]
            np.copyto(information, 0.0, where=unused[..., None])
            means = np.where(unused, 0.0, means)
        w = sharpened(information, w)
        weights = _neighbours_last(w, -1)
        origin = near_sharpest(_neighbours_last(means, -2), inverse_volume, weights)
        offsets = lanes_last(w[..., None] * (means - origin), 1)
        vector = np.einsum("j...ab,j...b->...a", information, offsets)
        mean, cov = to_gaussian(Information(vector, _average(information, w)))
        return Fused(Gaussian(origin + mean, symmetrise(cov)), weights, inverse_volume)


def sharpened(information: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weights (J, ...) after the steps, for information matrices P_j^-1 (J, ..., n, n).

    The matrices of weight zero are zero.
    """
    states = information.shape[-1]
    for _ in range(_STEPS):
        fused = inverse_spd(_average(information, weights))
        # The trace of a product of symmetric matrices is the sum of products of their entries.
        traces = np.einsum("j...ab,...ab->j...", information, fused)
        weights = weights * traces / states
    # Their sum is 1 but for rounding.
    return weights / np.add.reduce(weights)


def _average(information: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The sum of w_j P_j^-1 (..., n, n)."""
    return np.einsum("j...ab,j...->...ab", information, weights)


def _neighbours_first(values: np.ndarray, axis: int) -> np.ndarray:
    # A node has no other axis, and `moveaxis` takes longer than a sum of its arrays.
    return values if values.ndim == -axis else np.moveaxis(values, axis, 0)


def _neighbours_last(values: np.ndarray, axis: int) -> np.ndarray:
    return values if values.ndim == -axis else np.moveaxis(values, 0, axis)
