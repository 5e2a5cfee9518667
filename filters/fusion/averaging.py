"""Rules that fuse the beliefs of several nodes whose errors are correlated in an unknown way."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from concord.filters.fusion.hold import (
    check_weights,
    inverse_volume,
    inverse_volume_of_factor,
    times_inverse_volume,
)
from concord.filters.fusion.packed import (
    from_packed_information,
    pack,
    packed_inverse_volume,
    to_packed_information,
    unpack,
)
from concord.filters.gaussian import Gaussian, Information, joined
from concord.filters.linalg import cholesky, inverse_of_triangle, inverse_spd, multiply, symmetrise

# Variances of which the ratio is below this leave a sum about either mean its digits.
_ALIKE = 1e8


def near_sharpest(
    means: np.ndarray, inverse_volumes: np.ndarray, weights: np.ndarray | float = 1.0
) -> np.ndarray:
    """A point (..., n) about which an average of means (..., J, n) loses few digits.

    The first mean; but where another belief with a weight (..., J) is far sharper, as
    `inverse_volumes` (..., J) say, the mean of the sharpest. A sum of differences to a mean that is
    far off loses what the sharp ones know.
    """
    least = np.fmin.reduce(inverse_volumes, axis=None, initial=np.inf)
    most = np.fmax.reduce(inverse_volumes, axis=None, initial=-np.inf)
    # No lanes at all have no extremes either.
    if not most > _ALIKE * least:
        return means[..., 0, :]
    volumes = np.where((weights > 0) & ~np.isnan(inverse_volumes), inverse_volumes, 0.0)
    is_far = volumes.max(axis=-1) > _ALIKE * volumes[..., 0]
    if not is_far.any():
        return means[..., 0, :]
    sharpest = np.argmax(volumes, axis=-1)[..., None, None]
    found = np.take_along_axis(means, sharpest, axis=-2)[..., 0, :]
    return np.where(is_far[..., None], found, means[..., 0, :])


class Fused(NamedTuple):
    """Result of averaging a node's own belief with the beliefs of J others.

    `belief` (..., n) is the average, NaN where none exists; its covariance is symmetric to the last
    bit. `weights` (..., 1 + J) are the weights used, the own first. `inverse_volume` (..., 1 + J)
    is `hold.inverse_volume` of each belief, NaN where a covariance is not positive definite.
    """

    belief: Gaussian
    weights: np.ndarray
    inverse_volume: np.ndarray


class Averaged(Protocol):
    """A rule that averages beliefs, as a node goes through it that has several at hand."""

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool, /
    ) -> Fused:
        """Average the own belief (..., n) with others (..., J, n) under weights (..., 1 + J).

        With `by_inverse_volume`, multiply each weight by the belief's inverse volume
        (`hold.times_inverse_volume`).
        """
        ...


class Directly(NamedTuple):
    """A rule that is given as a function of beliefs and weights, such as those of this file."""

    of: Callable[[Gaussian, np.ndarray], Gaussian]

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool
    ) -> Fused:
        """Implement `Averaged.fuse`."""
        beliefs = joined(own, others)
        sharp = inverse_volume(beliefs.cov)
        used = times_inverse_volume(weights, sharp) if by_inverse_volume else weights
        mean, cov = self.of(beliefs, used)
        return Fused(Gaussian(mean, symmetrise(cov)), used, sharp)


@dataclass(frozen=True, slots=True)
class Averaging:
    """A rule as what it averages: numbers (..., m) that a belief is turned into and back.

    `to_numbers(belief, origin)` returns the numbers and `hold.inverse_volume` (...) of a belief.
    `from_numbers(numbers, origin)` returns the belief that an average of such numbers stands for.
    `inverse_volume(numbers)` returns the inverse volume of that belief. Means are taken about an
    `origin` (..., n), any point near them, which preserves their digits. Beliefs that are averaged
    must have the same origin.
    """

    to_numbers: Callable[[Gaussian, np.ndarray], tuple[np.ndarray, np.ndarray]]
    from_numbers: Callable[[np.ndarray, np.ndarray], Gaussian]
    inverse_volume: Callable[[np.ndarray], np.ndarray]

    def average(self, numbers: np.ndarray, weights: np.ndarray, origin: np.ndarray) -> Gaussian:
        """The belief that numbers (..., J, m) about one origin come to with weights (..., J).

        Numbers of weight zero may be anything, NaN included.
        """
        if np.count_nonzero(weights) < weights.size:
            # 0 * NaN would let them through.
            numbers = np.where((weights == 0)[..., None], 0.0, numbers)
        return self.from_numbers(multiply(numbers.mT, weights), origin)

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool
    ) -> Fused:
        """Implement `Averaged.fuse`."""
        numbers, origin, sharp = self.numbers_of(joined(own, others), weights)
        used = times_inverse_volume(weights, sharp) if by_inverse_volume else weights
        mean, cov = self.average(numbers, used, origin)
        return Fused(Gaussian(mean, symmetrise(cov)), used, sharp)

    def numbers_of(
        self, beliefs: Gaussian, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (..., J, m) of beliefs (..., J, n), their origin (..., n), inverse volumes."""
        first = beliefs.mean[..., 0, :]
        numbers, sharp = self.to_numbers(beliefs, first[..., None, :])
        origin = near_sharpest(beliefs.mean, sharp, weights)
        if (origin != first).any():
            numbers, sharp = self.to_numbers(beliefs, origin[..., None, :])
        return numbers, origin, sharp


class _Intersection(Averaging):
    """Averages of information, where one factorisation serves check, weight and average.

    With whiteners P_j^-1 = R_j' R_j, the sum of w_j P_j^-1 is S' S for the stack S of the rows of
    sqrt(w_j) R_j.
    """

    def fuse(
        self, own: Gaussian, others: Gaussian, weights: np.ndarray, by_inverse_volume: bool
    ) -> Fused:
        """Implement `Averaged.fuse`."""
        means, covs = joined(own, others)
        factor = cholesky(covs)
        sharp = inverse_volume_of_factor(factor)
        used = times_inverse_volume(weights, sharp) if by_inverse_volume else weights
        rows = np.sqrt(used)[..., None, None] * inverse_of_triangle(factor)
        origin = near_sharpest(means, sharp, used)
        offsets = means - origin[..., None, :]
        if np.count_nonzero(used) < used.size:
            # 0 * NaN would let them through.
            unused = (used == 0)[..., None]
            rows = np.where(unused[..., None], 0.0, rows)
            offsets = np.where(unused, 0.0, offsets)
        n = means.shape[-1]
        stack = rows.reshape(*means.shape[:-2], -1, n)
        whitened = multiply(rows, offsets).reshape(*stack.shape[:-1])
        cov = inverse_spd(stack.mT @ stack)
        mean = origin + multiply(cov, multiply(stack.mT, whitened))
        return Fused(Gaussian(mean, symmetrise(cov)), used, sharp)


def weighted_average(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Weighted averages of means and of covariances ("WAC"): x = sum w_j x_j, P = sum w_j P_j.

    Promises: if every P_j bounds its node's error covariance, P bounds the fused one, however the
    errors are correlated, because (sum w e)(sum w e)' <= sum w e e' (Jensen). Needs no inverse, so
    singular covariances pass.

    Fails: it is never tighter than `covariance_intersection`, and a node that sees nothing keeps
    its vote. On an unstable plant the network diverges even though some nodes see everything. Take
    a scalar plant F, weight matrix Pi, L rounds a step and D = diag(1 for blind nodes, 0 for nearly
    perfect sensors). The mean diverges if `|F| rho(Pi^L D)` > 1, the covariance if
    F^2 rho(Pi^L D) > 1. The promise assumes weights that do not depend on the errors.

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
    return _averaged(MOMENTS, beliefs, weights)


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
    return _averaged(INFORMATION, beliefs, weights)


def _moments(belief: Gaussian, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return pack(Information(belief.mean - origin, belief.cov)), inverse_volume(belief.cov)


def _of_moments(numbers: np.ndarray, origin: np.ndarray) -> Gaussian:
    offset, cov = unpack(numbers)
    return Gaussian(origin + offset, cov)


def _information(belief: Gaussian, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return to_packed_information(Gaussian(belief.mean - origin, belief.cov))


def _of_information(numbers: np.ndarray, origin: np.ndarray) -> Gaussian:
    offset, cov = from_packed_information(numbers)
    return Gaussian(origin + offset, cov)


MOMENTS = Averaging(_moments, _of_moments, packed_inverse_volume)
INFORMATION = _Intersection(
    _information, _of_information, lambda numbers: 1.0 / packed_inverse_volume(numbers)
)


def _averaged(rule: Averaging, beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    check_weights(weights)
    beliefs = _without_unweighted(beliefs, weights)
    numbers, origin, _ = rule.numbers_of(beliefs, weights)
    return rule.average(numbers, weights, origin)


def _without_unweighted(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Harmless stand-ins for entries of weight zero, of which nothing may come through."""
    unused = weights == 0
    if not unused.any():
        return beliefs
    n = beliefs.mean.shape[-1]
    return Gaussian(
        np.where(unused[..., None], 0.0, beliefs.mean),
        np.where(unused[..., None, None], np.eye(n), beliefs.cov),
    )
