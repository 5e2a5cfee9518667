"""Consensus weights: stochastic matrices that average over a graph.

Repeated multiplication with a doubly stochastic W carries every node's value to the network's
average (Xiao, Boyd: Fast linear iterations for distributed averaging, 2004). A W that is only
row-stochastic, as a directed graph allows, carries them to a weighted average.
"""

from collections.abc import Callable

import networkx
import numpy as np
from numpy.typing import NDArray

from topology.adjacency import Adjacency
from topology.analysis import require_connected
from topology.names import unknown_name

Array = NDArray[np.float64]

TOLERANCE = 1e-9


def metropolis(adjacency: Adjacency) -> Array:
    """W_ij = 1 / (1 + max(degree_i, degree_j)) on the links; (n, n) -> (n, n).

    Positive diagonal, and a node needs the degrees of its neighbours only (Xiao, Boyd, Lall 2005).
    """
    degree = adjacency.sum(axis=1)
    return _completed(adjacency / (1 + np.maximum(degree[:, None], degree)))


def maximum_degree(adjacency: Adjacency) -> Array:
    """W_ij = 1 / (1 + the greatest degree) on the links; (n, n) -> (n, n).

    Positive diagonal; every node must know the greatest degree (Olfati-Saber, Fax, Murray 2007).
    """
    return _completed(adjacency / (1.0 + adjacency.sum(axis=1).max()))


def best_constant(adjacency: Adjacency) -> Array:
    """The one weight for all links that converges fastest: 2 / (lambda_2 + lambda_n) of the graph's
    Laplacian (Xiao, Boyd 2004, section 4.1); (n, n) -> (n, n).

    The diagonal is negative where degrees differ much (at the hub of a star): such weights average
    numbers, but no covariances. `check_weights` refuses them.

    Raises:
        ValueError: if the graph is not connected, for then no weight converges.
    """
    require_connected(adjacency)
    if len(adjacency) == 1:
        return np.ones((1, 1))
    laplacian = np.diag(adjacency.sum(axis=1)) - adjacency.astype(float)
    eigenvalues = np.linalg.eigvalsh(laplacian)
    return _completed(adjacency * (2 / (eigenvalues[1] + eigenvalues[-1])))


def fastest_mixing(adjacency: Adjacency) -> Array:
    """The symmetric weights without negative entries that converge fastest: they minimise the
    contraction factor |W - 11'/n|, a semidefinite program (Xiao, Boyd 2004, section 4 with the
    entries bounded below by 0 as in Boyd, Diaconis, Xiao 2004); (n, n) -> (n, n).

    Raises:
        ValueError: the graph is not connected, the solver is not installed, or it fails.
    """
    require_connected(adjacency)
    try:
        import cvxpy
    except ImportError:
        raise ValueError(
            "weights fastest-mixing need a convex solver: install concord with the extra 'convex'"
        ) from None
    n = len(adjacency)
    weights = cvxpy.Variable((n, n), symmetric=True)
    factor = cvxpy.Variable()
    links = adjacency | np.eye(n, dtype=bool)
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
    solved = np.where(adjacency, np.maximum(weights.value, 0.0), 0.0)
    return _completed((solved + solved.T) / 2)


def equal_neighbour(adjacency: Adjacency) -> Array:
    """W_ij = 1 / (1 + number of nodes that i hears) for itself and each of them; (n, n) -> (n, n).

    Row-stochastic on any graph, directed ones included (Vicsek et al. 1995; Jadbabaie, Lin, Morse
    2003). On a graph of unequal degrees the limit is not the average: well-heard nodes count more.
    """
    heard = adjacency | np.eye(len(adjacency), dtype=bool)
    return heard / heard.sum(axis=1, keepdims=True)


def check_doubly_stochastic(weights: Array) -> None:
    """Whether weights (n, n) that pass `check_weights` keep the average.

    Raises:
        ValueError: a column does not sum to 1.
    """
    sums = weights.sum(axis=0)
    for i in np.flatnonzero(np.abs(sums - 1) > TOLERANCE):
        raise ValueError(
            f"weights: column {i} sums to {sums[i]:.12g}, but each must sum to 1 (doubly "
            "stochastic), or the network does not come to the average; use metropolis on a graph "
            "whose links go both ways"
        )


def check_weights(weights: Array, adjacency: Adjacency) -> None:
    """Whether fusion may use these weights (n, n) on this graph (n, n).

    Raises:
        ValueError: naming the first rule that is broken: finite with one row per node, no entry
            below 0, rows that sum to 1, nothing outside graph and diagonal, primitivity (some
            power has no zero, so that all nodes come to agree).
    """
    if weights.shape != adjacency.shape or not np.isfinite(weights).all():
        raise ValueError(
            f"weights of shape {weights.shape} for {len(adjacency)} nodes: "
            f"they must be finite with shape {adjacency.shape}"
        )
    for i, j in np.argwhere(weights < -TOLERANCE):
        raise ValueError(
            f"weights: entry ({i}, {j}) is {weights[i, j]:.3g}, but none may be below 0 (fusion "
            "would subtract a covariance); use metropolis"
        )
    sums = weights.sum(axis=1)
    for i in np.flatnonzero(np.abs(sums - 1) > TOLERANCE):
        raise ValueError(
            f"weights: row {i} sums to {sums[i]:.12g}, but each must sum to 1; put the difference "
            "on the diagonal"
        )
    for i, j in np.argwhere((weights != 0) & ~(adjacency | np.eye(len(adjacency), dtype=bool))):
        raise ValueError(
            f"weights: entry ({i}, {j}) is {weights[i, j]:.3g}, but node {i} does not hear "
            f"node {j}; set it to 0 or add the link"
        )
    hears = networkx.from_numpy_array(weights > 0, create_using=networkx.DiGraph)
    if not (networkx.is_strongly_connected(hears) and networkx.is_aperiodic(hears)):
        raise ValueError(
            "weights: they are not primitive (nodes fall apart, or take turns for ever), so they "
            "do not lead to agreement; connect the graph and give some node a weight of its own"
        )


_RULES: dict[str, Callable[[Adjacency], Array]] = {
    "metropolis": metropolis,
    "maximum-degree": maximum_degree,
    "best-constant": best_constant,
    "fastest-mixing": fastest_mixing,
    "equal-neighbour": equal_neighbour,
}


def weight_names() -> tuple[str, ...]:
    """What `build_weights` knows."""
    return tuple(_RULES)


def build_weights(name: str, adjacency: Adjacency) -> Array:
    """The weights (n, n) of that name for a graph (n, n).

    Raises:
        ValueError: for an unknown name; for `best-constant` on a graph in pieces.
    """
    if name not in _RULES:
        raise unknown_name("weights", name, _RULES)
    return _RULES[name](adjacency)


def _completed(off_diagonal: Array) -> Array:
    """The same with what each row lacks to 1 on its diagonal."""
    return off_diagonal + np.diag(1 - off_diagonal.sum(axis=1))
