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

from concord.filters.linalg import cholesky
from concord.filters.sets.criterion import Criterion, unit_free
from concord.filters.sets.ellipsoid import squared
from concord.filters.sets.rounding import pseudo_inverse, rounding_bound, row_units

ACCURACY = 5e-6
"""Duality gap, relative to the trace, that the search for multipliers ends at."""
# The path to the optimum: weight of the barrier relative to the trace, at first and from one to the
# next, how many at most, and Newton's steps on each.
_FIRST_BARRIER, _STEP_OF_BARRIER, _MOST_BARRIERS = 10.0**-0.5, 0.1, 11
_NEWTON_STEPS, _HALVINGS = 30, 20
# Squared Newton decrement at which a barrier is done, and the last one, on which the dual variables
# must be feasible; in between, where Newton's steps converge quadratically.
_ROUGH, _SMALL, _FINE = 0.5, 1e-3, 1e-10
# Weights of the barrier in the dual variables that are tried, in those of the last.
_DUAL_WEIGHTS = (0.5, 1.0, 2.0, 8.0)
# Squares of parts of `known` that fade out on the way to the result, relative to all.
_WEAK = 1e-14
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


class _Point(NamedTuple):
    """Multipliers, the trace there, and what Newton's step needs; trace inf where not feasible."""

    multipliers: np.ndarray
    trace: np.ndarray
    log_barrier: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    barrier_gradient: np.ndarray
    barrier_hessian: np.ndarray
    whitened_terms: np.ndarray


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
    return ~np.isnan(cholesky(total)[..., -1, -1])


def optimal_multipliers(
    problem: Problem, accuracy: float = ACCURACY
) -> tuple[np.ndarray, np.ndarray]:
    """tau (..., c) that minimise the trace, and a trace (...) below which none is.

    NaN in lanes in which no multipliers are feasible.
    """
    flat, scale, size = _normalised(problem)
    point = _evaluate(flat, _begin(flat))
    # On the path to the optimum the gap is the barrier's weight times the number of its terms.
    parameters = sum(problem.terms.shape[-2:-4:-1])
    barrier, weight = _FIRST_BARRIER, point.trace
    for _ in range(_MOST_BARRIERS):
        last = barrier * parameters <= accuracy
        # Relative to the trace, so that the units of the state do not matter.
        weight = barrier * np.maximum(point.trace, np.finfo(float).tiny)
        point = _centre(flat, point, weight, _FINE if last else _ROUGH)
        if last:
            break
        barrier *= _STEP_OF_BARRIER
    sound = np.isfinite(point.trace)
    found = np.where(sound[:, None], point.multipliers / scale, np.nan)
    least = np.where(sound, size**2 * _least_trace(flat, point, weight), np.nan)
    lanes = _lanes(problem)
    return found.reshape(*lanes, -1), least.reshape(lanes)


def _least_trace(problem: Problem, point: _Point, barrier: np.ndarray) -> np.ndarray:
    """A trace (...) that no multipliers undercut, by feasible points of the dual programme.

    With G = M^-1 E' E M^-1, E = image - L known at the best L, the dual variable is
    Z = G + w M^-1 + s e1 e1', w > 0 and s >= -w / M_11. It is feasible if <Z, T_i> <= 0 for every
    term, and its value is 2 tr P - Z_11. Weights w around that of the barrier are tried, each with
    the least s. Source: Boyd and Vandenberghe (2004), Convex optimization, section 5.9.
    """
    matrix = _certificate(problem, point.multipliers)
    whitener = np.linalg.inv(cholesky(matrix))
    image, known = problem.image @ whitener.mT, problem.known @ whitener.mT
    rows = _orthonormal_rows(known)
    residual = image - image @ rows.mT @ rows
    first = ((residual @ whitener[..., :1])[..., 0] ** 2).sum(-1)
    of_inverse = np.trace(point.whitened_terms, axis1=-2, axis2=-1)
    constant = problem.terms[..., 0, 0]
    best = np.zeros(point.trace.shape)
    for multiple in _DUAL_WEIGHTS:
        weight = multiple * barrier
        room = point.gradient - weight[:, None] * of_inverse
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = room / constant
        least = np.where(constant < 0.0, ends, -np.inf).max(-1)
        least = np.maximum(least, -weight / matrix[..., 0, 0])
        most = np.where(constant > 0.0, ends, np.inf).min(-1)
        feasible = (least <= most) & ((constant != 0.0) | (room >= 0.0)).all(-1)
        corner = first + weight * (whitener[..., 0] ** 2).sum(-1) + least
        best = np.where(feasible, np.maximum(best, 2.0 * point.trace - corner), best)
    return best


def _lanes(problem: Problem) -> tuple[int, ...]:
    arrays = (problem.terms[..., 0, :, :], problem.image, problem.known)
    return np.broadcast_shapes(*(array.shape[:-2] for array in arrays))


def _normalised(problem: Problem) -> tuple[Problem, np.ndarray, np.ndarray]:
    """The same problem on one axis of lanes, image, known and terms of size one; how much terms and
    image shrank.

    A run on an unstable plant reaches states whose squares overflow. The trace depends on
    image' image alone, so that a long image gives way to its triangle (d, d).
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
    image = image / size[..., None, None]
    if image.shape[-2] > image.shape[-1]:
        image = squared(image.mT).mT
    known = spread(problem.known, 2)
    flat = Problem(
        terms / scale[..., None, None], problem.balls, image, known / row_units(known)[..., None]
    )
    return flat, scale, size


def _rounding(problem: Problem, multipliers: np.ndarray) -> np.ndarray:
    """How far (...) an eigenvalue of sum tau_i T_i may be off."""
    sizes = np.abs(problem.terms).max((-1, -2))
    return rounding_bound(problem.terms.shape[-1]) * (multipliers * sizes).sum(-1)


def _certificate(problem: Problem, multipliers: np.ndarray) -> np.ndarray:
    matrix = np.einsum("...c,...cij->...ij", multipliers, problem.terms)
    matrix[..., 0, 0] += 1.0
    return matrix


def _begin(problem: Problem) -> np.ndarray:
    """Multipliers well inside: the balls share nine tenths, the rest takes next to nothing."""
    terms, balls = problem.terms, problem.balls
    count = terms.shape[-3]
    radius = np.maximum(1.0, -terms[..., :balls, 0, 0])
    start = np.zeros(terms.shape[:-2])
    start[..., :balls] = 0.9 / (balls * radius)
    if count > balls:
        room = np.linalg.eigvalsh(_certificate(problem, start))[..., :1]
        size = np.sqrt((terms[..., balls:, :, :] ** 2).sum((-1, -2)))
        start[..., balls:] = 0.1 * room / (count * np.maximum(size, 1.0))
    return start


def _evaluate(problem: Problem, multipliers: np.ndarray) -> _Point:
    """Everything at given multipliers."""
    lower = cholesky(_certificate(problem, multipliers))
    inside = ~np.isnan(lower[..., -1, -1]) & (multipliers > 0).all(-1)
    whitener = np.linalg.inv(lower)
    terms = whitener[..., None, :, :] @ problem.terms @ whitener.mT[..., None, :, :]
    image, known = problem.image @ whitener.mT, problem.known @ whitener.mT
    rows = _orthonormal_rows(known)
    residual = image - image @ rows.mT @ rows
    # tr P = |residual|^2 and its derivatives, with the gain always at its best.
    weighted = residual[..., None, :, :] @ terms
    free = weighted - weighted @ (rows.mT @ rows)[..., None, :, :]
    inverse = 1.0 / np.where(multipliers > 0, multipliers, np.nan)
    log_barrier = np.log(inverse).sum(-1)
    log_barrier -= 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1)
    curvature = np.einsum("...aij,...bij->...ab", terms, terms)
    curvature += (inverse**2)[..., None] * np.eye(inverse.shape[-1])
    return _Point(
        multipliers,
        np.where(inside, (residual**2).sum((-1, -2)), np.inf),
        log_barrier,
        -(weighted * residual[..., None, :, :]).sum((-1, -2)),
        2.0 * np.einsum("...aij,...bij->...ab", weighted, free),
        -np.trace(terms, axis1=-2, axis2=-1) - inverse,
        curvature,
        terms,
    )


def _centre(problem: Problem, point: _Point, weight: np.ndarray, enough: float) -> _Point:
    """Newton's method on trace / weight + log barrier; lanes that are done are left alone."""
    waiting, before = np.arange(len(weight)), np.full(len(weight), np.inf)
    for _ in range(_NEWTON_STEPS):
        here, at = _some(point, waiting), weight[waiting]
        gradient = here.gradient / at[:, None] + here.barrier_gradient
        hessian = here.hessian / at[:, None, None] + here.barrier_hessian
        step = _newton_step(hessian, gradient)
        decrement = -(gradient * step).sum(-1)
        # Newton's step squares a small decrement, until only rounding is left of it.
        stalled = (decrement < _SMALL) & (decrement > 0.1 * before[waiting])
        active = (decrement > enough) & ~stalled
        before[waiting] = decrement
        if not active.any():
            break
        waiting = waiting[active]
        moved = _search(problem, point, waiting, step[active], decrement[active], weight)
        waiting = waiting[moved]
    return point


def _search(
    problem: Problem,
    point: _Point,
    lanes: np.ndarray,
    step: np.ndarray,
    decrement: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    """Move the point in some lanes along their steps, as far as it stays inside and pays (Armijo).

    Returns which of them (bool) have moved: the others' gain is lost in rounding.
    """
    here, at = _some(point, lanes), weight[lanes]
    height = here.trace / at + here.log_barrier
    unseen = 1e-14 * here.trace / at
    length = np.minimum(1.0, 0.9 * _way_to_the_edge(here, step))
    waiting = np.arange(len(lanes))
    for _ in range(_HALVINGS):
        target = here.multipliers[waiting] + length[waiting, None] * step[waiting]
        trial = _evaluate(_part(problem, lanes[waiting]), target)
        drop = height[waiting] - (trial.trace / at[waiting] + trial.log_barrier)
        good = drop >= 0.1 * length[waiting] * decrement[waiting] - unseen[waiting]
        if good.all() and len(waiting) == len(point.trace):
            for whole, part in zip(point, trial, strict=True):
                whole[...] = part
            return np.ones(len(lanes), dtype=bool)
        for whole, part in zip(point, trial, strict=True):
            whole[lanes[waiting[good]]] = part[good]
        waiting = waiting[~good]
        if not len(waiting):
            break
        length[waiting] *= 0.5
    moved = np.ones(len(lanes), dtype=bool)
    moved[waiting] = False
    return moved


def _way_to_the_edge(point: _Point, step: np.ndarray) -> np.ndarray:
    """How many steps (...) lead to where M or a multiplier is no longer positive."""
    change = np.einsum("...c,...cij->...ij", step, point.whitened_terms)
    fall = np.maximum(-np.linalg.eigvalsh(change)[..., 0], (-step / point.multipliers).max(-1))
    return 1.0 / np.maximum(fall, np.finfo(float).tiny)


def _some(point: _Point, lanes: np.ndarray) -> _Point:
    if len(lanes) == len(point.trace):
        return point
    return _Point(*(part[lanes] for part in point))


def _part(problem: Problem, lanes: np.ndarray) -> Problem:
    if len(lanes) == len(problem.terms):
        return problem
    return problem._replace(
        terms=problem.terms[lanes], image=problem.image[lanes], known=problem.known[lanes]
    )


def _newton_step(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """-hessian^-1 gradient (lanes, c), with unit diagonal first; 0 in lanes without one."""
    scale = 1.0 / np.sqrt(np.diagonal(hessian, axis1=-2, axis2=-1))
    balanced = hessian * scale[:, :, None] * scale[:, None, :]
    right = gradient * scale
    sound = np.logical_and(np.isfinite(balanced).all((-1, -2)), np.isfinite(right).all(-1))
    if not sound.all():
        balanced, right = balanced * sound[:, None, None], right * sound[:, None]
    # Next to nothing on the diagonal: no lane may be singular, or all would fail.
    size = balanced.shape[-1]
    balanced.reshape(-1, size * size)[:, :: size + 1] += 1e-14
    return -np.linalg.solve(balanced, right[..., None])[..., 0] * scale


def _orthonormal_rows(matrix: np.ndarray) -> np.ndarray:
    """Rows (..., m, d) that span those of matrix (..., m, d); weak ones fade to zero."""
    gram = matrix @ matrix.mT
    total = np.trace(gram, axis1=-2, axis2=-1)[..., None, None]
    size = matrix.shape[-2]
    weak = (_WEAK * total + np.finfo(float).tiny) * np.eye(size)
    return np.linalg.inv(cholesky(gram + weak)) @ matrix
