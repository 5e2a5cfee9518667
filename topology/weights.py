"""Consensus weights: stochastic matrices that average over a graph.

Repeated multiplication with a doubly stochastic W carries every node's value to the network's
average (Xiao, Boyd: Fast linear iterations for distributed averaging, 2004). A W that is only
row-stochastic, as a directed graph allows, carries them to a weighted average.
"""

from collections.abc import Callable, Sequence

import networkx
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components

from concord.topology.adjacency import (
    Adjacency,
    degrees,
    entries,
    is_symmetric,
    links_of,
    nodes_of,
    one_way_links,
)
from concord.topology.analysis import require_connected
from concord.topology.names import WEIGHTS, unknown_name
from concord.topology.spectrum import laplacian_bounds

Weights = csr_array

TOLERANCE = 1e-9
# The semidefinite program has a variable per pair of nodes.
MOST_FASTEST_MIXING = 200


def metropolis(adjacency: Adjacency) -> Weights:
    """W_ij = 1 / (1 + max(degree_i, degree_j)) on the links; (n, n) -> (n, n).

    Positive diagonal, and a node needs the degrees of its neighbours only (Xiao, Boyd, Lall 2005).

    Raises:
        ValueError: a link goes one way, as for all rules but `equal_neighbour`.
    """
    _require_both_ways("metropolis", adjacency)
    degree = degrees(adjacency)
    i, j = links_of(adjacency)
    return _completed(adjacency, 1 / (1 + np.maximum(degree[i], degree[j])))


def maximum_degree(adjacency: Adjacency) -> Weights:
    """W_ij = 1 / (1 + the greatest degree) on the links; (n, n) -> (n, n).

    Positive diagonal; every node must know the greatest degree (Olfati-Saber, Fax, Murray 2007).
    """
    _require_both_ways("maximum-degree", adjacency)
    return _constant(adjacency, 1 / (1.0 + degrees(adjacency).max()))


def best_constant(adjacency: Adjacency) -> Weights:
    """The one weight for all links that converges fastest: 2 / (lambda_2 + lambda_n) of the graph's
    Laplacian (Xiao, Boyd 2004, section 4.1); (n, n) -> (n, n).

    The diagonal is negative where degrees differ much (at the hub of a star): such weights average
    numbers, but no covariances. `check_weights` refuses them.

    Raises:
        ValueError: if the graph is not connected, for then no weight converges.
    """
    _require_both_ways("best-constant", adjacency)
    require_connected(adjacency)
    if nodes_of(adjacency) == 1:
        return _constant(adjacency, 0.0)
    return _constant(adjacency, 2 / sum(laplacian_bounds(adjacency)))


def fastest_mixing(adjacency: Adjacency) -> Weights:
    """Return the fastest symmetric weights without negative entries; (n, n) -> (n, n).

    The weights minimise the contraction factor |W - 11'/n| by a semidefinite program. Source: Xiao,
    Boyd 2004, section 4, with the entries bounded below by 0 as in Boyd, Diaconis, Xiao 2004.

    Raises:
        ValueError: the graph is not connected or has more than `MOST_FASTEST_MIXING` nodes, the
            solver is not installed, or it fails.
    """
    _require_both_ways("fastest-mixing", adjacency)
    require_connected(adjacency)
    n = nodes_of(adjacency)
    if n > MOST_FASTEST_MIXING:
        raise ValueError(
            f"weights fastest-mixing for {n} nodes: the semidefinite program is solved for at most "
            f"{MOST_FASTEST_MIXING}; use best-constant or metropolis"
        )
    try:
        import cvxpy
    except ImportError:
        raise ValueError(
            "weights fastest-mixing need a convex solver: install concord with the extra 'convex'"
        ) from None
    weights = cvxpy.Variable((n, n), symmetric=True)
    factor = cvxpy.Variable()
    links = adjacency.toarray() | np.eye(n, dtype=bool)
    constraints = [
        weights[~links] == 0,
        weights[links] >= 0,
        cvxpy.sum(weights, axis=1) == 1,
        factor * np.eye(n) + (weights - 1 / n) >> 0,
        factor * np.eye(n) - (weights - 1 / n) >> 0,
    ]
    problem = cvxpy.Problem(cvxpy.Minimize(factor), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    if weights.value is None:
        raise ValueError(f"weights fastest-mixing: the solver found none ({problem.status})")
    # The solver is right to eight digits; the rest is put right where it cannot do harm.
    solved = np.maximum(weights.value, 0.0)
    i, j = links_of(adjacency)
    return _completed(adjacency, (solved[i, j] + solved[j, i]) / 2)


def equal_neighbour(adjacency: Adjacency) -> Weights:
    """W_ij = 1 / (1 + number of nodes that i hears) for itself and each of them; (n, n) -> (n, n).

    Row-stochastic on any graph, directed ones included (Vicsek et al. 1995; Jadbabaie, Lin, Morse
    2003). On a graph of unequal degrees the limit is not the average: well-heard nodes count more.
    """
    share = 1 / (1.0 + degrees(adjacency))
    heard = csr_array(adjacency, dtype=float) + eye_array(nodes_of(adjacency))
    return csr_array(diags_array(share) @ heard)


def check_doubly_stochastic(weights: Weights) -> None:
    """Whether weights (n, n) that pass `check_weights` keep the average.

    Raises:
        ValueError: a column does not sum to 1.
    """
    sums = np.asarray(weights.sum(axis=0)).ravel()
    for i in np.flatnonzero(np.abs(sums - 1) > TOLERANCE):
        raise ValueError(
            f"weights: column {i} sums to {sums[i]:.12g}, but each must sum to 1 (doubly "
            "stochastic), or the network does not come to the average; use metropolis on a graph "
            "whose links go both ways"
        )


def check_weights(weights: Weights, adjacency: Adjacency) -> None:
    """Check that fusion may use these weights (n, n) on this graph (n, n).

    Raises:
        ValueError: the weights break a rule; the message names the first. The rules: finite with
            one row per node, no entry below 0, rows that sum to 1, no entry outside graph and
            diagonal. The last rule is primitivity: some power has no zero, so all nodes come to
            agree.
    """
    if weights.shape != adjacency.shape or not np.isfinite(weights.data).all():
        raise ValueError(
            f"weights of shape {weights.shape} for {nodes_of(adjacency)} nodes: "
            f"they must be finite with shape {adjacency.shape}"
        )
    rows, columns = links_of(weights)
    values = entries(weights, rows, columns)
    for i, j, value in _first(values < -TOLERANCE, rows, columns, values):
        raise ValueError(
            f"weights: entry ({i}, {j}) is {value:.3g}, but none may be below 0 (fusion "
            "would subtract a covariance); use metropolis"
        )
    sums = np.asarray(weights.sum(axis=1)).ravel()
    for i in np.flatnonzero(np.abs(sums - 1) > TOLERANCE):
        raise ValueError(
            f"weights: row {i} sums to {sums[i]:.12g}, but each must sum to 1; put the difference "
            "on the diagonal"
        )
    unheard = (rows != columns) & (values != 0) & ~entries(adjacency, rows, columns)
    for i, j, value in _first(unheard, rows, columns, values):
        raise ValueError(
            f"weights: entry ({i}, {j}) is {value:.3g}, but node {i} does not hear "
            f"node {j}; set it to 0 or add the link"
        )
    if not _is_primitive(weights):
        raise ValueError(
            "weights: they are not primitive (nodes fall apart, or take turns for ever), so they "
            "do not lead to agreement; connect the graph and give some node a weight of its own"
        )


def _first(
    broken: NDArray[np.bool_], rows: NDArray[np.intp], columns: NDArray[np.intp], values: np.ndarray
) -> list[tuple[int, int, float]]:
    """Return the first entry that breaks a rule, if any does."""
    found = np.flatnonzero(broken)[:1]
    return [(int(rows[k]), int(columns[k]), float(values[k])) for k in found]


def _is_primitive(weights: Weights) -> bool:
    hears = csr_array(weights > 0)
    parts = connected_components(hears, connection="strong", return_labels=False)
    if parts > 1:
        return False
    # A node that listens to itself breaks every cycle's rhythm.
    if hears.diagonal().any():
        return True
    graph = networkx.from_scipy_sparse_array(hears, create_using=networkx.DiGraph)
    return networkx.is_aperiodic(graph)


_RULES: dict[str, Callable[[Adjacency], Weights]] = {
    "metropolis": metropolis,
    "maximum-degree": maximum_degree,
    "best-constant": best_constant,
    "fastest-mixing": fastest_mixing,
    "equal-neighbour": equal_neighbour,
}


def build_weights(name: str, adjacency: Adjacency) -> Weights:
    """Return the weights (n, n) of that name for a graph (n, n).

    Raises:
        ValueError: for an unknown name; for links that go one way under a rule that wants both;
            for `best-constant` on a graph in pieces.
    """
    if name not in _RULES:
        raise unknown_name("weights", name, WEIGHTS)
    return _RULES[name](adjacency)


def per_node(weights: Weights, neighbours: Sequence[Sequence[int]]) -> list[list[float]]:
    """Weights (n, n) as one list per node: its own, then those of its neighbours in their order."""
    rows = np.repeat(np.arange(len(neighbours)), [1 + len(heard) for heard in neighbours])
    columns = np.array([j for i, heard in enumerate(neighbours) for j in (i, *heard)])
    values = entries(weights, rows, columns)
    ends = np.searchsorted(rows, np.arange(1, len(neighbours)))
    return [part.tolist() for part in np.split(values, ends)]


def from_per_node(
    values: Sequence[Sequence[float]], neighbours: Sequence[Sequence[int]]
) -> Weights:
    """Weights (n, n) from one list per node, as `per_node` returns them."""
    nodes = len(neighbours)
    rows = np.repeat(np.arange(nodes), [1 + len(heard) for heard in neighbours])
    columns = [j for i, heard in enumerate(neighbours) for j in (i, *heard)]
    return csr_array((np.concatenate(values), (rows, columns)), shape=(nodes, nodes))


def masked(weights: Weights, adjacency: Adjacency) -> Weights:
    """Weights (n, n) while only the links of a graph (n, n) are up: each node keeps to itself what
    the others would have given."""
    return _completed(adjacency, entries(weights, *links_of(adjacency)))


def _require_both_ways(name: str, adjacency: Adjacency) -> None:
    if is_symmetric(adjacency):
        return
    one_way = one_way_links(adjacency)
    i, j = one_way[0]
    raise ValueError(
        f"weights {name} on a directed graph: they come to the average only where each link goes "
        f"both ways, and {len(one_way)} do not (node {i} hears node {j}, but not the other way); "
        "use weights equal-neighbour with a rule that takes any weights (ci, wac, hcmci), or give "
        "the graph each link both ways"
    )


def _constant(adjacency: Adjacency, weight: float) -> Weights:
    return _completed(adjacency, np.full(adjacency.nnz, weight))


def _completed(adjacency: Adjacency, on_links: np.ndarray) -> Weights:
    """Weights with `on_links` (links,) in the order of `links_of`, and what each row lacks to 1 on
    its diagonal."""
    i, j = links_of(adjacency)
    nodes = nodes_of(adjacency)
    own = 1 - np.bincount(i, weights=on_links, minlength=nodes)
    everyone = np.arange(nodes)
    entries = (np.append(i, everyone), np.append(j, everyone))
    return csr_array((np.append(on_links, own), entries), shape=(nodes, nodes))
