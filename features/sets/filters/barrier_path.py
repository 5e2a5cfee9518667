"""The path of barriers to the multipliers of least trace, and a trace below which none is.

On the path the trace over a weight plus a logarithmic barrier is least. As the weight falls, its
minimum goes to that of the trace. Newton's method follows the path.

A choice of axes eliminates the part that the centre follows. The null space of `known` spans the
first axes. With M = L L' in these axes, the trace depends on the first axes alone.

Source: Boyd and Vandenberghe (2004), Convex optimization, sections 5.9 and 11.6.
"""

import math
from typing import NamedTuple

import numpy as np

from concord.filters.linalg import cholesky, inverse_of_triangle

# The path to the optimum: weight of the barrier relative to the trace, at first and from one to the
# next, how many at most, and Newton's steps on each.
_FIRST_BARRIER, _STEP_OF_BARRIER, _MOST_BARRIERS = 10.0**-0.5, 0.1, 11
_NEWTON_STEPS, _HALVINGS = 30, 20
# Sums that the multipliers stay below. A sum is the inverse square of the thinnest width, relative
# to a ball. Terms that all but contradict each other let it grow without end at next to no gain,
# until rounding in M hides the trace. Lanes that come near a sum are followed again with the next;
# the result is taken where the trace is less than this part, which is more than rounding moves it.
_MOST_SUM, _NEAR = 1e6, 0.1
_NEXT_SUMS = ((1e8, 0.999), (1e10, 0.999), (1e12, 0.99), (math.inf, 0.5))
# Part of the way to the edge that a step may go.
_MOST_OF_THE_WAY = 0.9
# Squared Newton decrement at which a barrier is done, and the last one, on which the dual variables
# must be feasible; in between, where Newton's steps converge quadratically.
_ROUGH, _SMALL, _FINE = 0.5, 1e-3, 1e-10
# Stages of the path whose gap is below so many times the accuracy bound the trace too.
_COARSE = 1e4


class BarrierTask(NamedTuple):
    """Problems in lanes (L), in axes of which the first f span the null space of what is known.

    Attributes:
        terms: (L, c, d, d), of size one. balls: how many of them are balls.
        first: (L, d), the constant e1 of theta in these axes.
        image: (L, n, f) along the first axes, of size one.
        free: (L, 1, f), 1 for axes of the null space, 0 for those that a lane does not have.
        most: what the sum of the multipliers stays below.
    """

    terms: np.ndarray
    balls: int
    first: np.ndarray
    image: np.ndarray
    free: np.ndarray
    most: float = _MOST_SUM


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


def least_on_path(task: BarrierTask, accuracy: float) -> tuple[np.ndarray, np.ndarray]:
    """tau (L, c) that minimise the trace, and a trace (L,) below which none is.

    NaN in lanes in which no multipliers are feasible.

    Args:
        accuracy: the duality gap to reach, relative to the trace.
    """
    found, trace, least = _follow(task, accuracy)
    lanes, most = np.arange(len(found)), task.most
    for next_most, less_than in _NEXT_SUMS:
        lanes = lanes[found[lanes].sum(-1) > _NEAR * most]
        if not len(lanes):
            break
        beyond, trace_beyond, least_beyond = _follow(
            _part(task, lanes)._replace(most=next_most), accuracy
        )
        # Also where the terms contradict each other: the trace goes to zero there.
        less = trace_beyond < less_than * trace[lanes]
        lanes, most = lanes[less], next_most
        found[lanes], trace[lanes] = beyond[less], trace_beyond[less]
        least[lanes] = least_beyond[less]
    return found, least


def _follow(task: BarrierTask, accuracy: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The multipliers at the end of the path, the trace there, and one below which none is."""
    point = _evaluate(task, _begin(task))
    # On the path to the optimum the gap is the barrier's weight times the number of its terms.
    parameters = sum(task.terms.shape[-2:-4:-1]) + 1
    barrier, weight = _FIRST_BARRIER, point.trace
    least = np.zeros(point.trace.shape)
    for _ in range(_MOST_BARRIERS):
        last = barrier * parameters <= accuracy
        # Relative to the trace, so that the units of the state do not matter.
        weight = barrier * np.maximum(point.trace, np.finfo(float).tiny)
        point = _centre(task, point, weight, _FINE if last else _ROUGH)
        if last or barrier * parameters <= _COARSE * accuracy:
            # Where the last point is not centred for its rounding, the bound of an earlier one is.
            least = np.fmax(least, _least_trace(task, point))
        if last:
            break
        barrier *= _STEP_OF_BARRIER
    sound = np.isfinite(point.trace)
    found = np.where(sound[:, None], point.multipliers, np.nan)
    return found, point.trace, np.where(sound, least, np.nan)


def _least_trace(task: BarrierTask, point: _Point) -> np.ndarray:
    """A trace (L,) that no multipliers undercut, by feasible points of the dual programme.

    With G = M^-1 E' E M^-1, E = image - L known at the best L, the dual variable is
    Z = G + w M^-1 + s e1 e1', w >= 0 and s >= -w / M_11. It is feasible if <Z, T_i> <= 0 for every
    term, and its value is 2 tr P - Z_11. Source: Boyd and Vandenberghe (2004), section 5.9.
    """
    matrix = _certificate(task, point.multipliers)
    whitener = np.linalg.inv(cholesky(matrix))
    constant = (whitener @ task.first[..., None])[..., 0]
    residual = _residual(task, whitener)
    first = ((residual @ constant[:, : residual.shape[-1], None])[..., 0] ** 2).sum(-1)
    start = task.first[:, None, :]
    corners = (start[:, None] @ task.terms @ start.mT[:, None])[..., 0, 0]
    of_inverse = np.trace(point.whitened_terms, axis1=-2, axis2=-1)
    of_matrix = (start @ matrix @ start.mT)[:, :, 0]
    # A term each, then w >= 0 and the bound of s.
    rows = np.zeros((len(corners), corners.shape[-1] + 2, 2))
    rows[:, :-2, 0], rows[:, :-2, 1] = of_inverse, corners
    rows[:, -2:, 0], rows[:, -1, 1] = -1.0, -of_matrix[:, 0]
    most = np.concatenate((point.gradient, np.zeros((len(corners), 2))), axis=-1)
    cost = np.stack(((constant**2).sum(-1), np.ones(len(corners))), axis=-1)
    best: np.ndarray = 2.0 * point.trace - first - least_cost(rows, most, cost)
    return np.maximum(best, 0.0)


def least_cost(rows: np.ndarray, most: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """The least cost (L,) of two variables x with rows (L, k, 2) x <= most (L, k); inf without one.

    It is at a corner, where two of the rows hold with equality.
    """
    one, other = np.triu_indices(rows.shape[-2], 1)
    a, b = rows[:, one], rows[:, other]
    of_a, of_b = most[:, one], most[:, other]
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        first = (of_a * b[..., 1] - of_b * a[..., 1]) / determinant
        second = (a[..., 0] * of_b - b[..., 0] * of_a) / determinant
        within = (
            rows[:, None, :, 0] * first[..., None] + rows[:, None, :, 1] * second[..., None]
            <= most[:, None]
        )
    # Rounding must not deny the rows that meet there.
    corner = np.arange(len(one))
    within[:, corner, one] = within[:, corner, other] = True
    found = within.all(-1) & np.isfinite(first) & np.isfinite(second)
    # Parallel rows meet nowhere, or at infinity, where a cost is no number.
    first, second = np.where(found, first, 0.0), np.where(found, second, 0.0)
    costs = cost[:, :1] * first + cost[:, 1:] * second
    least: np.ndarray = np.where(found, costs, np.inf).min(-1)
    return least


def _certificate(task: BarrierTask, multipliers: np.ndarray) -> np.ndarray:
    """M (L, d, d)."""
    lanes, count, size = task.terms.shape[:3]
    sums = multipliers[:, None, :] @ task.terms.reshape(lanes, count, size * size)
    matrix: np.ndarray = sums.reshape(lanes, size, size)
    return matrix + task.first[:, :, None] * task.first[:, None, :]


def _residual(task: BarrierTask, whitener: np.ndarray) -> np.ndarray:
    """E L^-T (L, n, f), whose squares add up to the trace, with the gain at its best."""
    width = task.image.shape[-1]
    residual: np.ndarray = task.image @ whitener[:, :width, :width].mT
    return residual * task.free


def _begin(task: BarrierTask) -> np.ndarray:
    """Multipliers well inside: the balls share nine tenths; the rest takes half of the room."""
    terms, balls = task.terms, task.balls
    count = terms.shape[-3]
    start = task.first[:, None, None, :]
    corners = (start @ terms[:, :balls] @ start.mT)[..., 0, 0]
    inside = np.zeros(terms.shape[:-2])
    inside[:, :balls] = 0.9 / (balls * np.maximum(1.0, -corners))
    if count > balls:
        whitener = np.linalg.inv(cholesky(_certificate(task, inside)))[:, None]
        fall = -np.linalg.eigvalsh(whitener @ terms[:, balls:] @ whitener.mT)[..., 0]
        inside[:, balls:] = 0.5 / ((count - balls) * np.maximum(fall, 1.0))
    return inside


def _evaluate(task: BarrierTask, multipliers: np.ndarray) -> _Point:
    """Everything at given multipliers."""
    lanes, count, size = task.terms.shape[:3]
    lower = cholesky(_certificate(task, multipliers))
    room = 1.0 - multipliers.sum(-1) / task.most
    inside = ~np.isnan(lower[:, -1, -1]) & (multipliers > 0).all(-1) & (room > 0.0)
    room = np.where(inside, room, np.nan)
    whitener = inverse_of_triangle(lower)
    terms = whitener[:, None] @ task.terms @ whitener.mT[:, None]
    # tr P = |residual|^2 and its derivatives, with the gain always at its best.
    residual = _residual(task, whitener)
    width = residual.shape[-1]
    weighted = (residual[:, None] @ terms[..., :width, :width]) * task.free[:, None]
    weighted = weighted.reshape(lanes, count, -1)
    residual = residual.reshape(lanes, -1, 1)
    inverse = 1.0 / np.where(multipliers > 0, multipliers, np.nan)
    log_barrier = np.log(inverse).sum(-1)
    log_barrier -= 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(-1)
    log_barrier -= np.log(room)
    rows = terms.reshape(lanes, count, size * size)
    curvature = rows @ rows.mT
    curvature.reshape(lanes, -1)[:, :: count + 1] += inverse**2
    of_sum = 1.0 / (task.most * room[:, None])
    curvature += of_sum[..., None] ** 2
    return _Point(
        multipliers,
        np.where(inside, (residual**2).sum((-1, -2)), np.inf),
        log_barrier,
        -(weighted @ residual)[..., 0],
        2.0 * (weighted @ weighted.mT),
        of_sum - rows[..., :: size + 1].sum(-1) - inverse,
        curvature,
        terms,
    )


def _centre(task: BarrierTask, point: _Point, weight: np.ndarray, enough: float) -> _Point:
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
        point, moved = _search(task, point, waiting, step[active], decrement[active], weight)
        waiting = waiting[moved]
    return point


def _search(
    task: BarrierTask,
    point: _Point,
    lanes: np.ndarray,
    step: np.ndarray,
    decrement: np.ndarray,
    weight: np.ndarray,
) -> tuple[_Point, np.ndarray]:
    """Move the point in some lanes along their steps, as far as it stays inside and pays (Armijo).

    Returns the point, and which of the lanes (bool) have moved: the others' gain is lost in
    rounding.
    """
    here, at = _some(point, lanes), weight[lanes]
    height = here.trace / at + here.log_barrier
    unseen = 1e-14 * here.trace / at
    length = np.minimum(1.0, _MOST_OF_THE_WAY * _way_to_the_edge(here, step, task.most))
    waiting = np.arange(len(lanes))
    for _ in range(_HALVINGS):
        target = here.multipliers[waiting] + length[waiting, None] * step[waiting]
        trial = _evaluate(_part(task, lanes[waiting]), target)
        drop = height[waiting] - (trial.trace / at[waiting] + trial.log_barrier)
        good = drop >= 0.1 * length[waiting] * decrement[waiting] - unseen[waiting]
        if good.all() and len(waiting) == len(point.trace):
            return trial, good
        for whole, part in zip(point, trial, strict=True):
            whole[lanes[waiting[good]]] = part[good]
        waiting = waiting[~good]
        if not len(waiting):
            break
        length[waiting] *= 0.5
    moved = np.ones(len(lanes), dtype=bool)
    moved[waiting] = False
    return point, moved


def _way_to_the_edge(point: _Point, step: np.ndarray, most: float) -> np.ndarray:
    """How many steps (L,) lead to where M, a multiplier or the room of their sum is not positive.

    Where the barrier's own norm of the steps proves that the edge is farther than a step needs, it
    stands for the exact way.
    """
    norm = (step * (point.barrier_hessian @ step[..., None])[..., 0]).sum(-1)
    fall = np.sqrt(np.maximum(norm, 0.0))
    if (fall > _MOST_OF_THE_WAY).any():
        lanes, count, size = point.whitened_terms.shape[:3]
        change = step[:, None] @ point.whitened_terms.reshape(lanes, count, size * size)
        least = np.linalg.eigvalsh(change.reshape(lanes, size, size))[..., 0]
        exact = np.maximum(-least, (-step / point.multipliers).max(-1))
        exact = np.maximum(exact, step.sum(-1) / (most - point.multipliers.sum(-1)))
        fall = np.where(fall > _MOST_OF_THE_WAY, exact, fall)
    return 1.0 / np.maximum(fall, np.finfo(float).tiny)


def _some(point: _Point, lanes: np.ndarray) -> _Point:
    if len(lanes) == len(point.trace):
        return point
    return _Point(*(part[lanes] for part in point))


def _part(task: BarrierTask, lanes: np.ndarray) -> BarrierTask:
    if len(lanes) == len(task.terms):
        return task
    return task._replace(
        terms=task.terms[lanes],
        first=task.first[lanes],
        image=task.image[lanes],
        free=task.free[lanes],
    )


def _newton_step(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """-hessian^-1 gradient (L, c), with unit diagonal first; 0 in lanes without one."""
    size = hessian.shape[-1]
    scale = 1.0 / np.sqrt(hessian.reshape(-1, size * size)[:, :: size + 1])
    balanced = hessian * scale[:, :, None] * scale[:, None, :]
    right = gradient * scale
    if not math.isfinite(balanced.sum() + right.sum()):
        sound = np.asarray(np.isfinite(balanced).all((-1, -2)) & np.isfinite(right).all(-1))
        balanced = np.where(sound[:, None, None], balanced, 0.0)
        right = np.where(sound[:, None], right, 0.0)
        scale = np.where(sound[:, None], scale, 0.0)
    # Next to nothing on the diagonal: no lane may be singular, or all would fail.
    balanced.reshape(-1, size * size)[:, :: size + 1] += 1e-14
    return -np.linalg.solve(balanced, right[..., None])[..., 0] * scale
