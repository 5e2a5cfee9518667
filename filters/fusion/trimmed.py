"""Fusion that a few liars in a neighbourhood cannot drag away: trimmed covariance intersection."""

import numpy as np

from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.fusion.hold import check_weights, inverse_volume
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, multiply

# Squared distances below the first, in variances of the own belief, are equal, and so are those
# that agree in so many bits. The median of four lies halfway between two of them, so distances are
# often equal, and rounding must not decide which belief is dropped.
_ALIKE = 1e-12
_EQUAL_BITS = 20


def trimmed_intersection(beliefs: Gaussian, weights: np.ndarray, liars: int) -> Gaussian:
    """Covariance intersection of what is left when the farthest are dropped and the surest capped.

    With F = `liars`, of the beliefs that have a weight, the node's own first:

    1. the F neighbours whose means are farthest from the median of all (entry by entry), in
       standard deviations of the node's own belief, are dropped. Among equals the first ones are:
       those within 1e-6 standard deviations, and those whose distances agree to a millionth;
    2. the information is capped: no neighbour may be surer, in any direction, than the (F + 1)-th
       surest of all in its surest direction, both relative to the own covariance. The covariance of
       a surer neighbour is scaled up to this cap;
    3. the others are averaged by `covariance_intersection`, each with its weight times the
       `hold.inverse_volume` of its covariance after the cap.

    A node that hears fewer than 2 F neighbours cannot tell who lies, and keeps its own belief.

    Promises, with at most F liars among the neighbours, whatever they say: no mean that is averaged
    is farther from c than r, and the fused covariance is at least l times the own. Here c is the
    median, which lies between the least and the greatest honest mean in each entry. r is the
    distance from c of the farthest honest mean. l is the share of the own covariance to which the
    surest honest belief comes in its surest direction. Both r and l are measured in the frame in
    which the own covariance is 1. So liars can neither drag the mean out of what honest nodes say
    nor make the node deaf: with fused mean x and covariance P, (x - c)' P^-1 (x - c) <= r^2 / l.

    Fails: one node cannot be believed by itself. Information that only F neighbours or fewer hold
    does not come through at full strength, so blind nodes next to one that sees learn less. The
    errors decide which beliefs are dropped, so consistency is not proved as it is for
    `covariance_intersection`; the caps work the other way. That honest nodes of a network agree is
    proved for scalars, on graphs that are (2 F + 1)-robust (`concord.topology.analysis`).

    Sources: LeBlanc, Zhang, Koutsoukos and Sundaram (2013), Resilient asymptotic consensus in
    robust networks, IEEE Journal on Selected Areas in Communications 31(4). That paper gives the
    median, the dropping of F and the condition on the graph, for scalars (W-MSR). The cap on
    information is the project's own.

    Args:
        beliefs: mean (..., J, n), cov (..., J, n, n), the node's own first. Entries of weight zero
            may be anything, NaN included.
        weights: (..., J), not negative, sum 1.
        liars: F, 0 or more.

    Returns:
        mean (..., n), cov (..., n, n); NaN in a lane whose own covariance is not positive definite.

    Raises:
        ValueError: a weight is negative, or they do not sum to 1.
    """
    check_weights(weights)
    used = weights > 0
    used[..., 0] = True
    factor = cholesky(beliefs.cov[..., :1, :, :])
    own_mean, own_cov = beliefs.mean[..., :1, :], beliefs.cov[..., :1, :, :]
    # Harmless stand-ins for what has no weight.
    mean = np.where(used[..., None], beliefs.mean, own_mean)
    cov = np.where(used[..., None, None], beliefs.cov, own_cov)
    whitener = np.linalg.inv(factor)
    far = _far_ones(mean, whitener, used, liars)
    cov = cov * _growth(cov, whitener, used, liars)[..., None, None]
    enough = used.sum(axis=-1, keepdims=True) > 2 * liars
    kept = used & (enough & ~far)
    kept[..., 0] = True
    worth = np.where(kept, weights, 0.0)
    # Where the hold policy leaves the node nothing of its own, it still is what is left.
    worth[..., 0] = np.where(worth.sum(axis=-1) > 0, worth[..., 0], 1.0)
    worth = worth * np.where(kept, inverse_volume(cov), 0.0)
    return covariance_intersection(Gaussian(mean, cov), worth / worth.sum(axis=-1, keepdims=True))


def _far_ones(mean: np.ndarray, whitener: np.ndarray, used: np.ndarray, liars: int) -> np.ndarray:
    """Which (..., J) of the neighbours' means (..., J, n) are the farthest from the median."""
    median = np.nanmedian(np.where(used[..., None], mean, np.nan), axis=-2, keepdims=True)
    distance = np.square(multiply(whitener, mean - median)).sum(axis=-1)
    candidates = used.copy()
    candidates[..., 0] = False
    mantissa, exponent = np.frexp(np.where(distance < _ALIKE, 0.0, distance))
    rounded = np.ldexp(np.round(np.ldexp(mantissa, _EQUAL_BITS)), exponent - _EQUAL_BITS)
    nearness = np.where(candidates, -rounded, np.inf)
    rank = np.argsort(np.argsort(nearness, axis=-1, kind="stable"), axis=-1)
    return candidates & (rank < liars)


def _growth(cov: np.ndarray, whitener: np.ndarray, used: np.ndarray, liars: int) -> np.ndarray:
    """Return factors (..., J) for covariances (..., J, n, n), so that none is too sure."""
    against_own = whitener @ cov @ whitener.mT
    # LAPACK gives up a batch for one lane; what is no covariance makes its lane NaN in the end.
    sound = np.isfinite(against_own).all(axis=(-2, -1), keepdims=True)
    share = np.linalg.eigvalsh(np.where(sound, against_own, np.eye(cov.shape[-1])))[..., 0]
    ascending = np.sort(np.where(used, share, np.inf), axis=-1)
    place = min(liars, share.shape[-1] - 1)
    least = ascending[..., place, None]
    growth = np.where(used & (share < least) & np.isfinite(least), least / share, 1.0)
    growth[..., 0] = 1.0
    return growth
