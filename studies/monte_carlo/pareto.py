"""Pareto front between two figures of which less is better."""

import numpy as np


def front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Places of the points (P,) that no other is at most as dear and better than; by rising cost.

    Points with a NaN are never on it; of equal points the first is.
    """
    order = np.lexsort((error, cost))
    best = np.inf
    kept = []
    for place in order:
        if np.isfinite(cost[place]) and error[place] < best:
            best = error[place]
            kept.append(int(place))
    return np.array(kept, dtype=int)
