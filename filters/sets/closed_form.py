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
    radii,
    shared,
    turned,
    unknowns,
)
from concord.filters.sets.ellipsoid import Ellipsoid, replace_lost
from concord.filters.sets.lifted_cycle import AugmentedCycle
from concord.filters.sets.rounding import RANK_TOLERANCE, pseudo_inverse, row_units

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
    values = np.minimum(np.maximum(values, 0.0), 1.0)
    sizes = ((image @ free @ vectors) ** 2).sum(-2)
    return _least_sum(sizes, values)


def _least_sum(sizes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """argmin (...) over a in (0, 1) of sum sizes / (a values + (1 - a)(1 - values)), convex.

    Newton's method, halving the interval where it would leave it. It begins at the minimum of the
    sum in which each term is shared between a value of 0 and one of 1.
    """
    rest, slope = 1.0 - values, 2.0 * values - 1.0
    ends = np.sqrt((sizes * values).sum(-1)), np.sqrt((sizes * rest).sum(-1))
    low, high = np.zeros(ends[0].shape), np.ones(ends[0].shape)
    share = np.minimum(np.maximum(ends[0] / (ends[0] + ends[1] + _TINY), _EDGE), 1.0 - _EDGE)
    for _ in range(_ITERATIONS):
        at = rest + share[..., None] * slope
        ratio = slope / at
        parts = sizes * ratio / at
        first, second = -parts.sum(-1), 2.0 * (parts * ratio).sum(-1)
        low, high = np.where(first < 0, share, low), np.where(first > 0, share, high)
        following = share - first / np.maximum(second, _TINY)
        inside = (following > low) & (following < high)
        following = np.where(inside, following, 0.5 * (low + high))
        change = np.abs(following - share)
        share = np.minimum(np.maximum(following, _EDGE), 1.0 - _EDGE)
        # The step squares the error, and the trace, which is flat there, squares it once more.
        if (change <= 1e-3 * share * (1.0 - share)).all():
            break
    return share


def _null_space(matrix: np.ndarray) -> np.ndarray:
    """Columns (..., d, f) that span the null space of matrix (..., m, d); zero columns fill up."""
    _, singular, rows = np.linalg.svd(matrix / row_units(matrix)[..., None], full_matrices=True)
    strongest = singular.max(-1, keepdims=True, initial=0.0)
    # Singular values descend: what is known comes first.
    cuts = (singular > RANK_TOLERANCE * strongest).sum(-1)
    fewest = int(cuts.min(initial=matrix.shape[-2]))
    free = np.arange(fewest, rows.shape[-1]) >= cuts[..., None]
    return rows[..., fewest:, :].mT * free[..., None, :]
