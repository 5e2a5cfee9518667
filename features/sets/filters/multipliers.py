"""The small convex problem behind every trace-optimal ellipsoid, and the certificate it leaves.

The constraints on theta = (1, p) are quadratic, theta' T_i theta <= 0. The task is to find the
smallest ellipsoid that contains image theta. The centre may move by any linear map L of known
theta. The S-procedure gives such an ellipsoid for multipliers tau >= 0 with
M(tau) = e1 e1' + sum tau_i T_i > 0: P = (image - L known) M^-1 (image - L known)'. L is eliminated
exactly (least squares), and a few scalars are left: minimise tr P(tau) over tau >= 0, M(tau) >= 0.

Every tau on the way is a certificate, so the guarantee does not depend on how far a solver got. Its
accuracy does, and each result states its duality gap: how far at most the trace is from the least.

Source: Liu et al. (2021), theorem 1 and corollary 1. This is their semidefinite programme with P
and L eliminated (projection lemma). See also Boyd, El Ghaoui, Feron, Balakrishnan (1994), Linear
matrix inequalities in system and control theory, sections 2.6.2 and 2.6.3.
"""

from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.barrier_path import BarrierTask, least_on_path
from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.ellipsoid import squared
from concord.features.sets.filters.rounding import (
    RANK_TOLERANCE,
    pseudo_inverse,
    rounding_bound,
    row_units,
)
from concord.features.sets.options import ACCURACY
from concord.filters.linalg import cholesky

# Room inside M > 0, so that no rounding can close it.
_MARGIN = 1e-7


class Problem(NamedTuple):
    """Constraints and target of one problem per lane; d is the length of theta = (1, p).

    Attributes:
        terms: (..., c, d, d) symmetric, theta' T_i theta <= 0. The first `balls` of them together
            bound every entry of p and are negative in the first entry only by their radius.
        balls: how many.
        image: (..., n, d), what is to be held.
        known: (..., m, d), what the centre may follow.
    """

    terms: np.ndarray
    balls: int
    image: np.ndarray
    known: np.ndarray


class Bound(NamedTuple):
    """An ellipsoid around image theta - gain known theta, centred at zero.

    factor (..., n, d) of P, gain (..., n, m), multipliers (..., c); all NaN in a lane without any,
    which means that no theta meets all terms: the data contradict the bounds. gap (...): part of
    the trace, in the weights of the criterion, that is not proved to be necessary.
    """

    factor: np.ndarray
    gain: np.ndarray
    multipliers: np.ndarray
    gap: np.ndarray


def smallest_bound(
    problem: Problem, criterion: Criterion = unit_free, accuracy: float = ACCURACY
) -> Bound:
    """The ellipsoid with the smallest trace that the terms prove.

    Args:
        criterion: the weights of the rows of the image in the trace.
        accuracy: the duality gap to reach, relative to the trace.
    """
    weights = criterion(np.sqrt((problem.image**2).sum(-1)))
    weighted = problem._replace(image=weights[..., None] * problem.image)
    multipliers, least = optimal_multipliers(weighted, accuracy)
    bound = certified_bound(problem, multipliers)
    trace = ((weights[..., None] * bound.factor) ** 2).sum((-1, -2))
    gap = np.divide(trace - least, trace, out=np.zeros_like(trace), where=trace != 0.0)
    return bound._replace(gap=np.clip(gap, 0.0, 1.0))


def certified_bound(problem: Problem, multipliers: np.ndarray) -> Bound:
    """The ellipsoid that given multipliers (..., c) prove, without a gap; NaN where they prove
    none.

    The bound holds in floating point. M stays away from singular by more than its rounding error.
    P grows by the largest rounding error of M^-1. That relative error is d u / least eigenvalue of
    M with unit diagonal (Higham (2002), 10.1).
    """
    # Smaller multipliers are less near the edge: M(s tau) = (1 - s) e1 e1' + s M(tau).
    multipliers = multipliers / (1.0 + _MARGIN + _rounding(problem, multipliers))[..., None]
    matrix = _certificate(problem, multipliers)
    scale = 1.0 / np.sqrt(np.abs(np.diagonal(matrix, axis1=-2, axis2=-1)))
    balanced = matrix * scale[..., :, None] * scale[..., None, :]
    whitener = np.linalg.inv(cholesky(balanced))
    # At least the inverse of the least eigenvalue.
    sensitivity = (whitener**2).sum((-1, -2))
    safe = np.sqrt(1.0 + rounding_bound(matrix.shape[-1]) * sensitivity)[..., None, None]
    whitener = whitener * scale[..., None, :]
    gain = (problem.image @ whitener.mT) @ pseudo_inverse(problem.known @ whitener.mT)
    # Not the projection of the image: with this residual any gain is as sound as the best. Its
    # rounding before it is whitened is an error of the state, entry by entry.
    factor = (problem.image - gain @ problem.known) @ whitener.mT
    lost = contradiction(problem, multipliers)
    return Bound(
        np.where(lost[..., None, None], np.nan, safe * factor),
        np.where(lost[..., None, None], np.nan, gain),
        np.where(lost[..., None], np.nan, multipliers),
        np.full(lost.shape, np.nan),
    )


def contradiction(problem: Problem, multipliers: np.ndarray) -> np.ndarray:
    """Whether (...) the multipliers prove that no theta meets all terms: sum tau_i T_i > 0."""
    total = np.einsum("...c,...cij->...ij", multipliers, problem.terms)
    total[..., 0, 0] -= _rounding(problem, multipliers)
    if not (total[..., 0, 0] > 0.0).any():
        return np.zeros(total.shape[:-2], dtype=bool)
    return ~np.isnan(cholesky(total)[..., -1, -1])


def optimal_multipliers(
    problem: Problem, accuracy: float = ACCURACY
) -> tuple[np.ndarray, np.ndarray]:
    """tau (..., c) that minimise the trace, and a trace (...) below which none is.

    NaN in lanes in which no multipliers are feasible.
    """
    task, scale, size = _normalised(problem)
    found, least = least_on_path(task, accuracy)
    lanes = _lanes(problem)
    return (found / scale).reshape(*lanes, -1), (size**2 * least).reshape(lanes)


def _lanes(problem: Problem) -> tuple[int, ...]:
    arrays = (problem.terms[..., 0, :, :], problem.image, problem.known)
    return np.broadcast_shapes(*(array.shape[:-2] for array in arrays))


def _normalised(problem: Problem) -> tuple[BarrierTask, np.ndarray, np.ndarray]:
    """The same problem on one axis of lanes, in other axes, image and terms of size one; how much
    terms and image shrank.

    A run on an unstable plant reaches states whose squares overflow. The trace depends on
    image' image alone, so that a long image gives way to its triangle.
    """
    lanes = _lanes(problem)

    def spread(array: np.ndarray, own: int) -> np.ndarray:
        own_shape = array.shape[-own:]
        return np.broadcast_to(array, (*lanes, *own_shape)).reshape(-1, *own_shape)

    terms, image = spread(problem.terms, 3), spread(problem.image, 2)
    scale = np.abs(terms).max((-1, -2))
    scale[:, : problem.balls] = 1.0
    scale = np.where(scale > 0, scale, 1.0)
    size = np.abs(image).max((-1, -2))
    size = np.where(size > 0, size, 1.0)
    known = spread(problem.known, 2)
    _, singular, rows = np.linalg.svd(known / row_units(known)[..., None])
    # Singular values descend, and the axes are turned round: the null space comes first.
    axes = rows[:, ::-1].mT
    followed = (singular > RANK_TOLERANCE * singular.max(-1, keepdims=True, initial=0.0)).sum(-1)
    width = terms.shape[-1] - int(followed.min(initial=known.shape[-1]))
    free = np.arange(width) < (terms.shape[-1] - followed)[:, None]
    image = (image / size[:, None, None]) @ axes[..., :width]
    if image.shape[-2] > width:
        image = squared(image.mT).mT
    turned = axes.mT[:, None] @ (terms / scale[..., None, None]) @ axes[:, None]
    task = BarrierTask(turned, problem.balls, axes[:, 0], image, free[:, None].astype(float))
    return task, scale, size


def _rounding(problem: Problem, multipliers: np.ndarray) -> np.ndarray:
    """How far (...) an eigenvalue of sum tau_i T_i may be off."""
    sizes = np.abs(problem.terms).max((-1, -2))
    return rounding_bound(problem.terms.shape[-1]) * (multipliers * sizes).sum(-1)


def _certificate(problem: Problem, multipliers: np.ndarray) -> np.ndarray:
    matrix = np.einsum("...c,...cij->...ij", multipliers, problem.terms)
    matrix[..., 0, 0] += 1.0
    return matrix
