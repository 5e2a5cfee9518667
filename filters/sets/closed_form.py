"""The paper's estimator without the terms of the losers: a closed form in one multiplier.

With rho = 0 two multipliers are left, a for the ellipsoid before and (1 - a) / g for the noise. One
eigendecomposition makes every P(a) diagonal; its trace is convex in a, so Newton's method on one
number ends it. The same guarantee as `recursive_estimator`, some hundred times faster.

Source: Liu et al. (2021), theorem 1 with rho_j = 0; a sum of two ellipsoids after the feedback.
"""

import numpy as np

from concord.filters.sets.criterion import Criterion, unit_free
from concord.filters.sets.cycle import (
    CycleResult,
    Proof,
    check_sizes,
    follow,
    heard,
    shared,
    turned,
    unknowns,
)
from concord.filters.sets.ellipsoid import Ellipsoid, replace_lost
from concord.filters.sets.lifted_cycle import AugmentedCycle
from concord.filters.sets.rounding import RANK_TOLERANCE, pseudo_inverse, row_units

_ITERATIONS = 60
_EDGE = 1e-12


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
    of = unknowns(position, cycle)
    samples, seen = cycle.noise.shape[-2], position.shape[-1]
    image, known = of.image[..., 1:], of.known[..., 1:]
    size = image.shape[-1]
    # Both parts have half of the whole here: the factors of the halves are those of the balls.
    balls = shared(np.asarray(0.5), seen, size, samples) * np.sqrt(0.5)
    uncut = np.sqrt((image**2).sum(-1))
    weights = criterion(uncut)[..., None]
    share = _best_share(weights * image * balls, known * balls, seen)
    # Any share and any gain would do; with these the trace is least.
    stretch = shared(share, seen, size, samples)[..., None, :]
    image, known = image * stretch, known * stretch
    inverse = pseudo_inverse(known)
    gain = image @ inverse
    gap = np.full(share.shape, np.nan)
    proof = Proof(image - gain @ known, gain, known, inverse, gap, uncut)
    return follow(before, cycle, received, proof, criterion)


def _best_share(image: np.ndarray, known: np.ndarray, seen: int) -> np.ndarray:
    """a (...) in (0, 1) at which the trace of P(a) is least.

    On the null space of what is known P(a) = H (a U + (1 - a) V)^-1 H' with U + V = I.
    """
    free = _null_space(known)
    values, vectors = np.linalg.eigh(free[..., :seen, :].mT @ free[..., :seen, :])
    values = np.clip(values, 0.0, 1.0)
    sizes = ((image @ free @ vectors) ** 2).sum(-2)
    return _least_sum(sizes, values)


def _least_sum(sizes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """argmin (...) over a in (0, 1) of sum sizes / (a values + (1 - a)(1 - values)), convex.

    Newton's method, halving the interval where it would leave it.
    """
    low, high = np.zeros(sizes.shape[:-1]), np.ones(sizes.shape[:-1])
    slope = 2.0 * values - 1.0
    share = np.full(low.shape, 0.5)
    for _ in range(_ITERATIONS):
        at = 1.0 - values + share[..., None] * slope
        ratio = slope / at
        parts = sizes * ratio / at
        first, second = -parts.sum(-1), 2.0 * (parts * ratio).sum(-1)
        low, high = np.where(first < 0, share, low), np.where(first > 0, share, high)
        following = share - first / np.maximum(second, np.finfo(float).tiny)
        inside = (following > low) & (following < high)
        following = np.where(inside, following, 0.5 * (low + high))
        change, share = np.abs(following - share), np.clip(following, _EDGE, 1.0 - _EDGE)
        # The step squares the error, and the trace, which is flat there, squares it once more.
        if (change <= 1e-3 * share * (1.0 - share)).all():
            break
    return share


def _null_space(matrix: np.ndarray) -> np.ndarray:
    """Columns (..., d, d) that span the null space of matrix (..., m, d); zero columns fill up."""
    _, singular, rows = np.linalg.svd(matrix / row_units(matrix)[..., None], full_matrices=True)
    kept = np.zeros(rows.shape[:-1], dtype=bool)
    strongest = singular.max(-1, keepdims=True, initial=0.0)
    kept[..., : singular.shape[-1]] = singular > RANK_TOLERANCE * strongest
    return rows.mT * ~kept[..., None, :]
