"""Diameter of a graph in hops: exact where the cost allows it, otherwise two bounds.

Source: Takes, Kosters (2011), "Determining the diameter of small world networks", CIKM. Each search
bounds the eccentricity of every other node, so most nodes need no search of their own.
"""

import math

import numpy as np
from scipy.sparse.csgraph import shortest_path

from concord.topology.adjacency import Adjacency, is_symmetric, nodes_of

# So many searches at a time, for the sake of memory.
_TOGETHER = 32
# Links and nodes that all searches together may look at; some ten seconds.
_BUDGET = 1e9


def diameter_bounds(adjacency: Adjacency, searches: int | None = None) -> tuple[int, int]:
    """Return the least and the most that the diameter of a graph (n, n) in one piece can be.

    They are equal unless so many searches, as many as some seconds pay for when left out, could not
    tell.
    """
    nodes = nodes_of(adjacency)
    directed = not is_symmetric(adjacency)
    left = math.ceil(_BUDGET / (nodes + adjacency.nnz)) if searches is None else searches
    # Of the eccentricity of each node: that of the farthest from it.
    least, most = np.zeros(nodes), np.full(nodes, np.inf)
    open_ = np.ones(nodes, dtype=bool)
    found = 0.0
    while left > 0 and open_.any():
        sources = _promising(np.flatnonzero(open_), least, most)[: min(left, _TOGETHER)]
        left -= len(sources)
        # Rows hear columns, so these are hops against the way that messages go: no matter here.
        away = shortest_path(adjacency, unweighted=True, indices=sources)
        back = shortest_path(adjacency.T, unweighted=True, indices=sources) if directed else away
        eccentricity = away.max(axis=1, keepdims=True)
        found = max(found, float(eccentricity.max()))
        least = np.maximum(least, np.maximum(back, eccentricity - away).max(axis=0))
        most = np.minimum(most, (eccentricity + back).min(axis=0))
        open_[sources] = False
        found = max(found, float(least.max()))
        open_ &= most > found
    return int(found), int(max(most[open_].max(initial=found), found))


def _promising(open_: np.ndarray, least: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Nodes to search from: in turn one that may be far from others, and one that is near all."""
    far = open_[np.argsort(-most[open_], kind="stable")]
    near = open_[np.argsort(least[open_], kind="stable")]
    both = np.stack((far, near), axis=1).ravel()
    _, first = np.unique(both, return_index=True)
    return both[np.sort(first)]
