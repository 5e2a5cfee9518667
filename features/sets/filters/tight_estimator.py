"""Set membership that cuts with what was received: the tight relative of the paper's estimator.

Three changes make it tighter, and the guarantee stays. First, every noise sample has a multiplier
of its own instead of one for all. Second, the received values cut the set of possible states; the
paper's feedback only moves the centre. Third, once the winner's change is known, the constraint on
a loser is a convex strip, |change_j| <= sqrt(Q_winner / Q_j) |change_winner|.

With one step at a time in place of a whole cycle the same function gives an ellipsoid in every
step. Without readings the result is the sum of ellipsoids. With one reading it is the classical
set-membership filter (Schweppe (1968); Fogel and Huang (1982)).

Source: Liu et al. (2021), the system of section III under its own bounds; the sections on
conditioning are ours, after Boyd et al. (1994), section 3.7.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.cycle import flat
from concord.features.sets.filters.ellipsoid import (
    Ellipsoid,
    grow,
    half_widths,
    is_lost,
    lose,
    replace_lost,
    squared,
)
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    magnitudes,
    taken,
)
from concord.features.sets.filters.multipliers import ACCURACY, Problem, smallest_bound
from concord.features.sets.filters.rounding import (
    RANK_TOLERANCE,
    pseudo_inverse,
    rounding_bound,
    row_units,
)
from concord.filters.linalg import join_columns, join_stacks, multiply


class ConditionedResult(NamedTuple):
    """The ellipsoid after a step, and the duality gap (...) relative to its trace."""

    after: Ellipsoid
    gap: np.ndarray


def conditioned_step(
    before: Ellipsoid, evidence: StepReadings, criterion: Criterion = unit_free
) -> Ellipsoid:
    """The ellipsoid of `conditioned`, to the usual accuracy."""
    return conditioned(before, evidence, criterion).after


def conditioned(
    before: Ellipsoid,
    evidence: StepReadings,
    criterion: Criterion = unit_free,
    accuracy: float = ACCURACY,
) -> ConditionedResult:
    """The ellipsoid (..., k) of what becomes of a state in `before` (..., n), given the evidence.

    Of those that the multipliers prove it has the least trace, in the weights of the criterion and
    but for a relative duality gap of `accuracy`. NaN in lanes in which the readings contradict the
    bounds.

    Raises:
        ValueError: the ellipsoid has not the states of the plant.
    """
    n = evidence.motion.state.shape[-1]
    if before.centre.shape[-1] != n:
        raise ValueError(
            f"an ellipsoid of {before.centre.shape[-1]} states for a plant of {n}; give one of {n}"
        )
    motion, exact, bounded = evidence.motion, taken(evidence.exact), taken(evidence.bounded)
    lost, before = is_lost(before), replace_lost(before, 0.0)
    # A set that was picked from a longer one, as the last step of a cycle, has columns to spare.
    if before.factor.shape[-1] > before.factor.shape[-2]:
        before = before._replace(factor=squared(before.factor))
    rank = before.factor.shape[-1]
    image = _joined(before, motion.state, motion.noise)
    cut, slack = _cut(before, exact)
    balls = _balls(cut, rank, motion.noise.shape[-2], slack)
    terms = join_stacks(balls, _strips(before, bounded, cut, slack))
    reached = image @ cut
    size = reached.shape[-1]
    known = np.broadcast_to(np.eye(size)[:1], (*reached.shape[:-2], 1, size))
    # The weights are those of the set before it is cut.
    uncut = np.sqrt((image**2).sum(-1))
    weights = criterion(uncut)
    asked = Problem(terms, balls.shape[-3], reached, known)
    bound = smallest_bound(asked, lambda _: weights, accuracy)
    centre = multiply(motion.state, before.centre) + bound.gain[..., 0]
    after = Ellipsoid(centre, bound.factor)
    grown = grow(after, _rounding(before, motion, exact, image), criterion, uncut)
    lost = lost | is_lost(after)
    return ConditionedResult(lose(grown, lost), np.where(lost, np.nan, bound.gap))


def _joined(before: Ellipsoid, state: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Both maps as one (..., rows, r + g q) of (u, v)."""
    return join_columns(state @ before.factor, flat(noise))


def _cut(before: Ellipsoid, exact: Readings) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) = cut (1, s) meets the exact readings for every s: (..., d, 1 + free), and a slack.

    The slack (...) is how far rounding may have moved the readings, in units of u and v. Readings
    that say next to nothing more than others are left out, which is always allowed.
    """
    seen = _joined(before, exact.state, exact.noise)
    offset = exact.values - multiply(exact.state, before.centre)
    lanes = np.broadcast_shapes(seen.shape[:-2], offset.shape[:-1])
    seen = np.broadcast_to(seen, (*lanes, *seen.shape[-2:]))
    size, count = seen.shape[-1], seen.shape[-2]
    if count == 0:
        everything = join_columns(np.zeros((size, 1)), np.eye(size))
        return np.broadcast_to(everything, (*lanes, *everything.shape)), np.zeros(lanes)
    reach = np.abs(before.centre) + half_widths(before)
    moved = rounding_bound(size + before.centre.shape[-1]) * (
        magnitudes(exact, reach) + np.abs(exact.values)
    )
    # Readings in units of their own spread; one that is known to its rounding says nothing.
    units = row_units(seen)
    silent = units <= moved
    seen = np.where(silent[..., None], 0.0, seen / units[..., None])
    offset, moved = np.where(silent, 0.0, offset / units), np.where(silent, 0.0, moved / units)
    left, singular, rows = np.linalg.svd(seen, full_matrices=True)
    kept = singular > RANK_TOLERANCE * singular.max(-1, keepdims=True)
    inverse = np.divide(1.0, singular, out=np.zeros_like(singular), where=kept)
    along = multiply(left.mT, offset)[..., : singular.shape[-1]] * inverse
    middle = multiply(rows.mT[..., : singular.shape[-1]], along)
    # Singular values descend: what is cut comes first. Lanes with less to cut keep more free.
    cuts = kept.sum(-1)
    fewest = int(cuts.min())
    free = np.arange(fewest, size) >= cuts[..., None]
    basis = rows.mT[..., fewest:] * free[..., None, :]
    slack = np.sqrt((moved**2).sum(-1)) * inverse.max(-1)
    return join_columns(middle[..., None], basis), slack


def _balls(cut: np.ndarray, rank: int, samples: int, slack: np.ndarray) -> np.ndarray:
    """The terms of |u| <= 1 and of |v_i| <= 1 for each sample: (..., 1 + g, k, k)."""
    width = (cut.shape[-2] - rank) // samples
    edges = [0, *(rank + width * sample for sample in range(samples + 1))]
    radius = (1.0 + rounding_bound(cut.shape[-2]) + slack) ** 2
    terms = []
    for first, last in pairwise(edges):
        part = cut[..., first:last, :]
        terms.append(_square(part, radius))
    # Free entries that a lane does not have are held by the first ball, and reach nothing.
    missing = (cut[..., 1:] == 0.0).all(-2)
    terms[0][..., 1:, 1:] += missing[..., None] * np.eye(missing.shape[-1])
    return np.stack(terms, axis=-3)


def _strips(before: Ellipsoid, bounded: Readings, cut: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """The terms of the bounded readings: (..., b, k, k)."""
    seen = _joined(before, bounded.state, bounded.noise)
    offset = multiply(bounded.state, before.centre) - bounded.values
    reach = np.abs(before.centre) + half_widths(before)
    moved = rounding_bound(seen.shape[-1] + before.centre.shape[-1]) * (
        magnitudes(bounded, reach) + np.abs(bounded.values)
    )
    length = np.sqrt((seen**2).sum(-1))
    half_widths_ = bounded.half_widths + moved + length * slack[..., None]
    rows = seen @ cut
    rows = join_columns(rows[..., :1] + offset[..., None], rows[..., 1:])
    return _square(rows[..., None, :], half_widths_**2)


def _square(rows: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The term of |rows (1, s)|^2 <= radius."""
    term = rows.mT @ rows
    term[..., 0, 0] -= radius
    return term


def _rounding(
    before: Ellipsoid, motion: BoundedMotion, exact: Readings, image: np.ndarray
) -> np.ndarray:
    """Half-widths (..., k) of what rounding does to centre, shape and truth."""
    reach = np.abs(before.centre) + half_widths(before)
    states = magnitudes(motion, reach)
    seen = _joined(before, exact.state, exact.noise)
    if seen.shape[-2]:
        # The centre follows the readings through the pseudo-inverse of what they see.
        followed = np.abs(image @ pseudo_inverse(seen))
        outputs = magnitudes(exact, reach) + np.abs(exact.values)
        states = states + multiply(followed, outputs)
    terms = image.shape[-1] + before.centre.shape[-1] + states.shape[-1]
    return rounding_bound(terms) * states
