"""Scores of estimated targets beside the true ones: OSPA, GOSPA with its parts, and identities."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NOT_ASSIGNED = -1
CUTOFF_M, ORDER = 50.0, 2
"""Of the project's scores."""


class Gospa(NamedTuple):
    """Generalised OSPA of one step, in m, and what it consists of.

    Attributes:
        distance: (localisation + (missed + false) c^p / 2)^(1/p).
        localisation: sum of the p-th powers of the distances of the pairs that are assigned.
        missed: number of true targets without an estimate.
        false: number of estimates without a true target.
        assigned: (K,), the estimate of each true target, -1 where it is missed.
    """

    distance: float
    localisation: float
    missed: int
    false: int
    assigned: np.ndarray


def gospa(truth: np.ndarray, estimates: np.ndarray, cutoff: float, order: float = 2) -> Gospa:
    """GOSPA with alpha = 2 of positions (K, d) and (M, d).

    Source: Rahmathullah, Garcia-Fernandez and Svensson (2017), Generalized optimal sub-pattern
    assignment metric, FUSION, equation 1 and proposition 1.
    """
    costs = _distances(truth, estimates, cutoff) ** order
    rows, columns = _assigned(costs)
    near = costs[rows, columns] < cutoff**order
    assigned = np.full(len(truth), NOT_ASSIGNED)
    assigned[rows[near]] = columns[near]
    localisation = float(costs[rows[near], columns[near]].sum())
    missed, false = len(truth) - int(near.sum()), len(estimates) - int(near.sum())
    total = localisation + (missed + false) * cutoff**order / 2
    return Gospa(total ** (1 / order), localisation, missed, false, assigned)


def ospa(truth: np.ndarray, estimates: np.ndarray, cutoff: float, order: float = 2) -> float:
    """OSPA of positions (K, d) and (M, d) in m; 0 where both are empty.

    Source: Schuhmacher, Vo and Vo (2008), A consistent metric for performance evaluation of
    multi-object filters, IEEE Trans. Signal Processing 56(8), equation 3.
    """
    most = max(len(truth), len(estimates))
    if not most:
        return 0.0
    costs = _distances(truth, estimates, cutoff) ** order
    total = costs[_assigned(costs)].sum()
    total += cutoff**order * abs(len(truth) - len(estimates))
    return float((total / most) ** (1 / order))


def _assigned(costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the assignment of least total cost."""
    # Only here: commands without several targets need not load scipy.
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(costs)


def _distances(truth: np.ndarray, estimates: np.ndarray, cutoff: float) -> np.ndarray:
    """Distances (K, M), at most the cutoff."""
    return np.minimum(np.linalg.norm(truth[:, None, :] - estimates, axis=-1), cutoff)


def identity_switches(assigned: Sequence[dict[int, object]]) -> float:
    """Number of identity switches of true targets.

    A change from one track to another counts 1. A target that loses its track, or is found again,
    counts 1/2 each time; before its first track it counts nothing.

    Source: Garcia-Fernandez, Rahmathullah and Svensson (2020), A metric on the space of finite sets
    of trajectories, IEEE Trans. Signal Processing 68, section III.

    Args:
        assigned: for each step, the identity of the track of each true target that is there; None
            where it has none.
    """
    last: dict[int, object] = {}
    switches = 0.0
    for step in assigned:
        for target, identity in step.items():
            if target not in last:
                if identity is not None:
                    last[target] = identity
            elif last[target] != identity:
                is_change = last[target] is not None and identity is not None
                switches += 1.0 if is_change else 0.5
                last[target] = identity
    return switches
