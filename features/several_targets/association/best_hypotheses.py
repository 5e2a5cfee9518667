"""The best joint hypotheses: the best one by assignment, the k best by Murty's partition."""

import heapq

import numpy as np

from concord.features.several_targets.association.weights import Weights

MISSED = -1


def best_hypothesis(weights: Weights) -> np.ndarray:
    """Detection (T,) of each track in the joint hypothesis of greatest weight; -1 where missed."""
    solved = _solve(_costs(weights))
    assert solved is not None, "a track can always miss"
    return _detections(solved[1], weights)


def best_hypotheses(weights: Weights, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint hypotheses of greatest weight, best first.

    Source: Murty (1968), An algorithm for ranking all the assignments in order of increasing cost,
    Operations Research 16(3). Equal weights stand in the order of their detections.

    Returns:
        Detections (k, T) with -1 for a miss, and log-weights (k,); k is less than `number` where
        there are fewer hypotheses.
    """
    costs = _costs(weights)
    tracks = len(costs)
    first = _solve(costs)
    assert first is not None, "a track can always miss"
    # A part of all hypotheses: its best one, rows that are settled, and costs without the others.
    waiting = [(first[0], first[1], 0, costs)]
    found: list[tuple[float, tuple[int, ...]]] = []
    while waiting:
        cost, columns, settled, allowed = heapq.heappop(waiting)
        found.append((cost, columns))
        if len(found) == number:
            break
        for row in range(settled, tracks):
            # The part that agrees with this hypothesis up to `row`, and differs from it there.
            other = allowed.copy()
            other[row, columns[row]] = np.inf
            solved = _solve(other)
            if solved is not None:
                heapq.heappush(waiting, (*solved, row, other))
            allowed = allowed.copy()
            keep = allowed[row, columns[row]]
            allowed[row], allowed[:, columns[row]] = np.inf, np.inf
            allowed[row, columns[row]] = keep
    chosen = np.array([_detections(columns, weights) for _, columns in found])
    return chosen, -np.array([cost for cost, _ in found])


def _costs(weights: Weights) -> np.ndarray:
    """Costs (T, D + T): detections, then for each track a column of its own that is its miss."""
    tracks, detections = weights.hit.shape
    chances = np.zeros((tracks, detections + tracks))
    chances[:, :detections] = weights.hit
    chances[np.arange(tracks), detections + np.arange(tracks)] = weights.miss
    with np.errstate(divide="ignore"):
        return -np.log(chances)


def _solve(costs: np.ndarray) -> tuple[float, tuple[int, ...]] | None:
    """Return the least cost and its columns; None where nothing is possible."""
    # The solver refuses a matrix in which every column of a row is impossible.
    if np.isinf(costs).all(axis=1).any():
        return None
    # Only here: a node without several targets need not load it.
    from scipy.optimize import linear_sum_assignment

    try:
        rows, columns = linear_sum_assignment(costs)
    except ValueError:
        return None
    # Not a sum by the solver: that of equal hypotheses may differ in its last bit.
    return float(np.sum(costs[rows, columns])), tuple(columns.tolist())


def _detections(columns: tuple[int, ...], weights: Weights) -> np.ndarray:
    chosen = np.array(columns, dtype=int)
    return np.where(chosen < weights.hit.shape[1], chosen, MISSED)
