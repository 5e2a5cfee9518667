"""What a graph and its weights promise: connection, weak points, speed of agreement."""

import math
from dataclasses import dataclass

import networkx
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from topology.adjacency import Adjacency

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Analysis:
    """A graph with weights, in figures.

    `diameter` and `rounds_to_one_percent` are None where no number is large enough: the graph is in
    pieces, or its weights never lead to agreement.
    """

    nodes: int
    links: int
    components: tuple[tuple[int, ...], ...]
    degree_min: int
    degree_mean: float
    degree_max: int
    diameter: int | None
    cut_nodes: tuple[int, ...]
    second_eigenvalue_modulus: float
    contraction_per_round: float
    rounds_to_one_percent: int | None


def analyse(adjacency: Adjacency, weights: Array) -> Analysis:
    """The figures of a graph (n, n) under weights (n, n)."""
    graph = networkx.from_numpy_array(adjacency)
    degree = adjacency.sum(axis=1)
    parts = components(adjacency)
    modulus = second_eigenvalue_modulus(weights)
    return Analysis(
        nodes=len(adjacency),
        links=int(degree.sum()) // 2,
        components=parts,
        degree_min=int(degree.min()),
        degree_mean=float(degree.mean()),
        degree_max=int(degree.max()),
        diameter=networkx.diameter(graph) if len(parts) == 1 else None,
        cut_nodes=tuple(sorted(networkx.articulation_points(graph))),
        second_eigenvalue_modulus=modulus,
        contraction_per_round=contraction_per_round(weights),
        rounds_to_one_percent=rounds_to(0.01, modulus),
    )


def components(adjacency: Adjacency) -> tuple[tuple[int, ...], ...]:
    """The connected parts of a graph (n, n): their nodes ascending, parts by their first node."""
    count, label = connected_components(adjacency, directed=False)
    parts = (tuple(np.flatnonzero(label == part).tolist()) for part in range(count))
    return tuple(sorted(parts))


def require_connected(adjacency: Adjacency) -> None:
    """Raises ValueError that names the parts of a graph (n, n) unless it is in one piece."""
    parts = components(adjacency)
    if len(parts) > 1:
        named = "; ".join(_abbreviated(part) for part in parts[:8])
        more = f"; and {len(parts) - 8} more" if len(parts) > 8 else ""
        raise ValueError(
            f"the graph is in {len(parts)} pieces that cannot hear each other ({named}{more}); "
            "add links or raise the radio range"
        )


def second_eigenvalue_modulus(weights: Array) -> float:
    """Second largest modulus among the eigenvalues of row-stochastic weights (n, n).

    By this factor disagreement falls per round in the long run (Xiao, Boyd 2004, the asymptotic
    convergence factor); 0 for one node.
    """
    eigenvalues = np.linalg.eigvals(weights)
    # All rows sum to 1, so one eigenvalue is 1; the one nearest to it is that one.
    others = np.delete(eigenvalues, np.argmin(np.abs(eigenvalues - 1)))
    return min(float(np.abs(others).max(initial=0.0)), 1.0)


def contraction_per_round(weights: Array) -> float:
    """The largest part of a disagreement that one round of doubly stochastic weights (n, n) leaves.

    Xiao, Boyd 2004, the per-step convergence factor. Symmetric weights have it equal to the second
    eigenvalue modulus.
    """
    return float(np.linalg.norm(_without_average(weights), ord=2))


def rounds_to(disagreement: float, factor: float) -> int | None:
    """The least number of rounds that bring disagreement down to `disagreement` times what it was,
    if each leaves `factor` of it; None if no number does.

    Raises:
        ValueError: unless 0 < disagreement < 1.
    """
    if not 0 < disagreement < 1:
        raise ValueError(f"disagreement {disagreement} must lie between 0 and 1; give 0.01 for 1 %")
    if factor >= 1 - 1e-12:
        return None
    if factor <= disagreement:  # a complete graph leaves nothing, and 0 has no logarithm
        return 1
    return math.ceil(math.log(disagreement) / math.log(factor))


def _without_average(weights: Array) -> Array:
    """W - 11'/n: the same on disagreements, zero on agreement."""
    return weights - 1 / len(weights)


def _abbreviated(part: tuple[int, ...]) -> str:
    shown = ", ".join(map(str, part[:12]))
    return f"nodes {shown}, ... ({len(part)})" if len(part) > 12 else f"nodes {shown}"
