"""The recursive set-membership estimator of the paper, with its semidefinite programme solved.

After every cycle the estimator returns the ellipsoid of least trace that theorem 1 proves. One
multiplier belongs to the ellipsoid before, and one to the noise of all samples together. Each
contending output that lost has one too: its term says that the winner's change was larger. The
received values enter through the feedback and, in the terms of the losers, through the estimate.
They never cut the set: states that they exclude stay in it (`tight_estimator` cuts).

Source: Liu et al. (2021), theorem 1, corollary 1 and algorithm 1, with the held values of (30)
those before the cycle.
"""

import numpy as np

from concord.features.sets.filters.closed_form import closed_form_step
from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.cycle import (
    CycleResult,
    Proof,
    ball,
    check_sizes,
    flat,
    follow,
    heard,
    parted,
    radii,
    turned,
    unknowns,
)
from concord.features.sets.filters.ellipsoid import Ellipsoid, half_widths, replace_lost
from concord.features.sets.filters.lifted_cycle import AugmentedCycle
from concord.features.sets.filters.multipliers import ACCURACY, Problem, smallest_bound
from concord.features.sets.filters.rounding import magnitudes, pseudo_inverse, rounding_bound
from concord.filters.linalg import join_columns, join_stacks, multiply, squared_lengths

# The closed form is taken where its trace is this part: more than the accuracy of the programme.
_MUCH_LESS = 0.999


def optimal_step(
    before: Ellipsoid,
    cycle: AugmentedCycle,
    received: np.ndarray,
    criterion: Criterion = unit_free,
    accuracy: float = ACCURACY,
    samples_apart: bool = False,
) -> CycleResult:
    """The ellipsoid after a cycle in which `received` (..., m) came (corollary 1).

    NaN in lanes in which no theta meets the terms, or none explains what was received: the bounds
    are wrong. A value that is NaN was not received.

    Args:
        criterion: the weights of the states; `plain_trace` for the paper's.
        accuracy: the duality gap to reach, relative to the trace.
        samples_apart: each noise sample has a multiplier of its own, not one for all as in (25).
    """
    check_sizes(before, cycle, received)
    cycle, received = heard(cycle, received)
    sound = replace_lost(before, 0.0)
    position = turned(sound.factor, cycle)
    asked = problem(sound, cycle, position, samples_apart)
    bound = smallest_bound(asked, criterion, accuracy)
    # The balls alone, with the multipliers that were found, say what can have been received.
    samples, seen = cycle.noise.shape[-2], position.shape[-1]
    of_noise = bound.multipliers[..., 1 : asked.balls].sum(-1)
    parts = bound.multipliers[..., 0], (1 if samples_apart else samples) * of_noise
    share = parts[0] / (parts[0] + parts[1])
    known = asked.known[..., 1:]
    size = known.shape[-1]
    known = known * (radii(seen, size, samples) / parted(share, seen, size))
    uncut = np.sqrt(squared_lengths(asked.image))
    proof = Proof(bound.factor, bound.gain, known, pseudo_inverse(known), bound.gap, uncut)
    found = follow(before, cycle, received, proof, criterion)
    closed = closed_form_step(before, cycle, received, criterion)
    return _smaller(found, closed, criterion(uncut))


def _smaller(found: CycleResult, closed: CycleResult, weights: np.ndarray) -> CycleResult:
    """The result of the programme, or that of the closed form where it is smaller.

    A multiplier of 0 for each loser is one of the choices. Where widths differ by more than
    rounding leaves of their squares, the search ends far from the least.
    """
    ours, other = (squared_lengths(weights * half_widths(one.after)) for one in (found, closed))
    better = other < _MUCH_LESS * ours
    if not better.any():
        return found
    lanes = better[..., None]
    after = Ellipsoid(
        np.where(lanes, closed.after.centre, found.after.centre),
        np.where(lanes[..., None], closed.after.factor, found.after.factor),
    )
    gain = np.where(lanes[..., None], closed.gain, found.gain)
    # A bound of the least trace that is above one that was found is none.
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = 1.0 - (1.0 - found.gap) * ours / other
    return CycleResult(after, gain, np.where(better, np.where(gap >= 0.0, gap, 1.0), found.gap))


def problem(
    before: Ellipsoid, cycle: AugmentedCycle, position: np.ndarray, samples_apart: bool = False
) -> Problem:
    """The matrix inequality (20) as terms: -Omega + Xi = M(tau), Gamma = image - L known.

    position: R (..., N, r); the factor of `before` for (20) as printed, or that `turned`, which
    gives the same P with fewer unknowns.
    """
    of = unknowns(position, cycle)
    image, known = (join_columns(np.zeros((map_.shape[-2], 1)), map_) for map_ in of)
    size, seen = image.shape[-1], position.shape[-1]
    samples, numbers = cycle.noise.shape[-2:]
    # A hair more than the bounds: what is on them in exact arithmetic may be rounded out.
    hair = 1.0 + rounding_bound(size)
    # Columns of the noise of one sample after the other, or of all together.
    groups = [((1 + seen, size - 1 - seen), samples)]
    if samples_apart:
        groups = [((1 + seen + sample * numbers, numbers), 1) for sample in range(samples)]
    balls = np.stack(
        [ball(1, seen, size, hair), *(ball(*of_noise, size, n * hair) for of_noise, n in groups)]
    )
    terms = join_stacks(balls, _losers(before, cycle, position))
    return Problem(terms, len(balls), image, known)


def _losers(before: Ellipsoid, cycle: AugmentedCycle, position: np.ndarray) -> np.ndarray:
    """Sigma' (Q_j - Q_winner) Sigma of every j but the winner: (..., c - 1, d, d) of (31)."""
    constant = multiply(cycle.candidates, before.centre)[..., None]
    noise = flat(cycle.candidates_noise)
    change = join_columns(constant, cycle.candidates @ position, noise)
    squares = cycle.weights[..., :, None, None] * change[..., :, None] * change[..., None, :]
    # A bound of the rounding error of the comparison, added as a constant that weakens the term.
    reach = np.abs(before.centre) + half_widths(before)
    of = cycle.majorant or cycle
    largest = magnitudes(of.candidates, of.candidates_noise, reach)
    slack = rounding_bound(change.shape[-1]) * np.abs(cycle.weights) * largest**2
    winner = np.asarray(cycle.winner)[..., None]
    count = cycle.weights.shape[-1]
    if count < 2:
        size = change.shape[-1]
        return np.zeros((*change.shape[:-2], 0, size, size))
    lost = np.arange(count - 1) + (np.arange(count - 1) >= winner)
    of_losers = np.take_along_axis(squares, lost[..., None, None], -3)
    of_winner = np.take_along_axis(squares, winner[..., None, None], -3)
    terms = of_losers - of_winner
    terms[..., 0, 0] -= np.take_along_axis(slack, lost, -1) + np.take_along_axis(slack, winner, -1)
    # Bids are rounded: a loser's weighted squared change may be larger by the excess.
    terms[..., 0, 0] -= cycle.excess[..., None]
    # Without a winner, or of a loser without a weight, nothing is known; -1 <= 0 says nothing.
    silent = (winner < 0) | (
        np.take_along_axis(np.broadcast_to(cycle.weights, slack.shape), lost, -1) == 0.0
    )
    nothing = -np.outer(*np.eye(1, change.shape[-1]).repeat(2, 0))
    return np.where(silent[..., None, None], nothing, terms)
