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

from concord.bus.measurement_bus import BID_RESOLUTION
from concord.filters.lanes import join_columns, join_stacks
from concord.filters.linalg import multiply
from concord.filters.sets.criterion import Criterion, unit_free
from concord.filters.sets.ellipsoid import Ellipsoid, half_widths, replace_lost
from concord.filters.sets.rounding import magnitudes, pseudo_inverse, rounding_bound
from concord.papers.liu2021.cycle import (
    CycleResult,
    Proof,
    ball,
    check_sizes,
    flat,
    follow,
    heard,
    shared,
    turned,
    unknowns,
)
from concord.papers.liu2021.flexray_cycle import AugmentedCycle
from concord.papers.liu2021.multipliers import ACCURACY, Problem, smallest_bound


def optimal_step(
    before: Ellipsoid,
    cycle: AugmentedCycle,
    received: np.ndarray,
    criterion: Criterion = unit_free,
    accuracy: float = ACCURACY,
) -> CycleResult:
    """The ellipsoid after a cycle in which `received` (..., m) came (corollary 1).

    NaN in lanes in which no theta meets the terms, or none explains what was received: the bounds
    are wrong. A value that is NaN was not received.

    Args:
        criterion: the weights of the states; `plain_trace` for the paper's.
        accuracy: the duality gap to reach, relative to the trace.
    """
    check_sizes(before, cycle, received)
    cycle, received = heard(cycle, received)
    sound = replace_lost(before, 0.0)
    position = turned(sound.factor, cycle)
    asked = problem(sound, cycle, position)
    bound = smallest_bound(asked, criterion, accuracy)
    # The balls alone, with the multipliers that were found, say what can have been received.
    samples, seen = cycle.noise.shape[-2], position.shape[-1]
    parts = bound.multipliers[..., 0], samples * bound.multipliers[..., 1]
    share = parts[0] / (parts[0] + parts[1])
    known = asked.known[..., 1:]
    known = known * shared(share, seen, known.shape[-1], samples)[..., None, :]
    uncut = np.sqrt((asked.image**2).sum(-1))
    proof = Proof(bound.factor, bound.gain, known, pseudo_inverse(known), bound.gap, uncut)
    return follow(before, cycle, received, proof, criterion)


def problem(before: Ellipsoid, cycle: AugmentedCycle, position: np.ndarray) -> Problem:
    """The matrix inequality (20) as terms: -Omega + Xi = M(tau), Gamma = image - L known.

    position: R (..., N, r); the factor of `before` for (20) as printed, or that `turned`, which
    gives the same P with fewer unknowns.
    """
    of = unknowns(position, cycle)
    size, seen = of.image.shape[-1], position.shape[-1]
    samples = cycle.noise.shape[-2]
    # A hair more than the bounds: what is on them in exact arithmetic may be rounded out.
    hair = 1.0 + rounding_bound(size)
    balls = np.stack(
        [ball(1, seen, size, hair), ball(1 + seen, size - 1 - seen, size, samples * hair)]
    )
    terms = join_stacks(balls, _losers(before, cycle, position))
    return Problem(terms, len(balls), of.image, of.known)


def _losers(before: Ellipsoid, cycle: AugmentedCycle, position: np.ndarray) -> np.ndarray:
    """Sigma' (Q_j - Q_winner) Sigma of every j but the winner: (..., c - 1, d, d) of (31)."""
    constant = multiply(cycle.candidates, before.centre)[..., None]
    noise = flat(cycle.candidates_noise)
    change = join_columns(constant, cycle.candidates @ position, noise)
    squares = cycle.weights[:, None, None] * change[..., :, None] * change[..., None, :]
    # A bound of the rounding error of the comparison, added as a constant that weakens the term.
    reach = np.abs(before.centre) + half_widths(before)
    of = cycle.majorant or cycle
    largest = magnitudes(of.candidates, of.candidates_noise, reach)
    slack = rounding_bound(change.shape[-1]) * np.abs(cycle.weights) * largest**2
    winner = np.asarray(cycle.winner)[..., None]
    count = len(cycle.weights)
    if count < 2:
        size = change.shape[-1]
        return np.zeros((*change.shape[:-2], 0, size, size))
    lost = np.arange(count - 1) + (np.arange(count - 1) >= winner)
    of_losers = np.take_along_axis(squares, lost[..., None, None], -3)
    of_winner = np.take_along_axis(squares, winner[..., None, None], -3)
    # Bids are rounded: a loser's squared change may be larger by their resolution.
    terms = of_losers - (1.0 + BID_RESOLUTION) * of_winner
    terms[..., 0, 0] -= np.take_along_axis(slack, lost, -1) + np.take_along_axis(slack, winner, -1)
    # Without a winner nothing was compared; -1 <= 0 says nothing.
    nothing = -np.outer(*np.eye(1, change.shape[-1]).repeat(2, 0))
    return np.where((winner < 0)[..., None, None], nothing, terms)
