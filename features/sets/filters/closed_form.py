"""The paper's estimator without the terms of the losers: a closed form in one multiplier.

With rho = 0 two multipliers are left, a for the ellipsoid before and (1 - a) / g for the noise. One
eigendecomposition makes every P(a) diagonal; its trace is convex in a, so Halley's method on one
number ends it. The same guarantee as `recursive_estimator`, some hundred times faster.

Source: Liu et al. (2021), theorem 1 with rho_j = 0; a sum of two ellipsoids after the feedback.
"""

import numpy as np

from concord.features.sets.filters.criterion import Criterion, unit_free
from concord.features.sets.filters.cycle import (
    CycleResult,
    Proof,
    check_sizes,
    follow,
    heard,
    parted,
    radii,
    turned,
    unknowns,
)
from concord.features.sets.filters.ellipsoid import Ellipsoid, replace_lost
from concord.features.sets.filters.lifted_cycle import AugmentedCycle
from concord.features.sets.filters.rounding import pseudo_inverse_and_null_space
from concord.filters.linalg import squared_lengths

_ITERATIONS = 60
_EDGE = 1e-12
_TINY = float(np.finfo(float).tiny)


def closed_form_step(
    before: Ellipsoid,
    cycle: AugmentedCycle,
    received: np.ndarray,
    criterion: Criterion = unit_free,
) -> CycleResult:
    """The ellipsoid after a cycle in which `received` (..., m) came, NaN where a frame was lost.

    NaN in lanes in which the received values contradict the bounds.
    """
    check_sizes(before, cycle, received)
    cycle, received = heard(cycle, received)
    position = turned(replace_lost(before, 0.0).factor, cycle)
    samples, seen = cycle.noise.shape[-2], position.shape[-1]
    image, known = unknowns(position, cycle)
    size = image.shape[-1]
    balls = radii(seen, size, samples)
    uncut = np.sqrt(squared_lengths(image))
    weights = criterion(uncut)[..., None]
    inverse, free = pseudo_inverse_and_null_space(known * balls)
    share, free = _best_share(weights * (image * balls), free, seen)
    # Any share and any gain would do; with these the trace is least.
    parts = parted(share, seen, size)
    stretch = balls / parts
    image, known = image * stretch, known * stretch
    # The shortest solution of known x = y is any solution less its part in the null space.
    inverse, free = parts.mT * inverse, parts.mT * free
    inverse = inverse - free @ (free.mT @ inverse)
    gain = image @ inverse
    gap = np.full(share.shape, np.nan)
    proof = Proof(image - gain @ known, gain, known, inverse, gap, uncut)
    return follow(before, cycle, received, proof, criterion)


def _best_share(image: np.ndarray, free: np.ndarray, seen: int) -> tuple[np.ndarray, np.ndarray]:
    """a (...) in (0, 1) at which the trace of P(a) is least, and a basis (..., d, f) of `free`.

    On the null space of what is known P(a) = H (a U + (1 - a) V)^-1 H' with U + V = I. The basis
    makes a U + (1 - a) V the identity.
    """
    values, vectors = np.linalg.eigh(free[..., :seen, :].mT @ free[..., :seen, :])
    values = np.minimum(np.maximum(values, 0.0), 1.0)
    free = free @ vectors
    share = _least_sum(squared_lengths((image @ free).mT), values)
    both = share[..., None] * values + (1.0 - share[..., None]) * (1.0 - values)
    return share, free / np.sqrt(both)[..., None, :]


def _least_sum(sizes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """argmin (...) over a in (0, 1) of sum sizes / (a values + (1 - a)(1 - values)), convex.

    Halley's method, halving the interval where it would leave it. It begins at the minimum of the
    sum in which each term is shared between a value of 0 and one of 1.
    """
    rest, slope = 1.0 - values, 2.0 * values - 1.0
    ends = np.sqrt(np.vecdot(sizes, values)), np.sqrt(np.vecdot(sizes, rest))
    low, high = np.zeros(()), np.ones(())
    share = np.minimum(np.maximum(ends[0] / (ends[0] + ends[1] + _TINY), _EDGE), 1.0 - _EDGE)
    for _ in range(_ITERATIONS):
        at = rest + share[..., None] * slope
        ratio = slope / at
        bent = sizes / at * ratio
        first, second = -bent.sum(-1), 2.0 * np.vecdot(bent, ratio)
        third = -6.0 * np.vecdot(bent * ratio, ratio)
        # Where terms of unlike slopes meet, Halley's bend may be negative; a term alone has 1/4.
        bend = second - 0.5 * first * third / np.maximum(second, _TINY)
        bend = np.maximum(bend, 0.25 * second)
        low, high = np.where(first < 0, share, low), np.where(first > 0, share, high)
        following = share - first / np.maximum(bend, _TINY)
        inside = (following > low) & (following < high)
        following = np.where(inside, following, 0.5 * (low + high))
        change = np.abs(following - share)
        share = np.minimum(np.maximum(following, _EDGE), 1.0 - _EDGE)
        # The step cubes the error, and the trace, which is flat there, squares it once more.
        if (change <= 3e-2 * share * (1.0 - share)).all():
            break
    return share
