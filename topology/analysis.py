"""Properties of a graph and its weights: connection, weak points, speed of agreement."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import networkx
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

from concord.topology.adjacency import Adjacency, degrees, is_symmetric, links_of, nodes_of
from concord.topology.spectrum import contraction_per_round, second_eigenvalue_modulus

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


@dataclass(frozen=True)
class Analysis:
    """A graph with weights, in figures.

    `links` are pairs of nodes, or pairs (receiver, sender) where the graph is `directed`.
    `components` are the parts whose nodes all reach each other (strongly, in a directed graph).
    `weak_components` are the parts that are connected when directions are ignored. The loss of one
    of `cut_nodes` or `cut_links` divides a part. `diameter` is None if the graph is not connected;
    it is also None if the graph is so large that only its `diameter_bounds` are known.
    `rounds_to_one_percent` is None if the weights never lead to agreement.
    """

    nodes: int
    links: int
    directed: bool
    components: tuple[tuple[int, ...], ...]
    weak_components: int
    degree_min: int
    degree_mean: float
    degree_max: int
    diameter: int | None
    diameter_bounds: tuple[int, int] | None
    cut_nodes: tuple[int, ...]
    cut_links: tuple[tuple[int, int], ...]
    second_eigenvalue_modulus: float
    contraction_per_round: float
    rounds_to_one_percent: int | None


def analyse(adjacency: Adjacency, weights: csr_array) -> Analysis:
    """Return the figures of a graph (n, n) under weights (n, n)."""
    degree = degrees(adjacency)
    directed = not is_symmetric(adjacency)
    parts = components(adjacency)
    modulus = second_eigenvalue_modulus(weights)
    bounds = diameter_bounds(adjacency) if len(parts) == 1 else None
    return Analysis(
        nodes=nodes_of(adjacency),
        links=int(degree.sum()) if directed else int(degree.sum()) // 2,
        directed=directed,
        components=parts,
        weak_components=connected_components(adjacency, directed=False, return_labels=False),
        degree_min=int(degree.min()),
        degree_mean=float(degree.mean()),
        degree_max=int(degree.max()),
        diameter=None if bounds is None or bounds[0] < bounds[1] else bounds[0],
        diameter_bounds=bounds,
        cut_nodes=cut_nodes(adjacency),
        cut_links=cut_links(adjacency),
        second_eigenvalue_modulus=modulus,
        contraction_per_round=contraction_per_round(weights),
        rounds_to_one_percent=rounds_to(0.01, modulus),
    )


def components(adjacency: Adjacency) -> tuple[tuple[int, ...], ...]:
    """The parts of a graph (n, n) whose nodes all reach each other: their nodes ascending, parts by
    their first node."""
    count, label = connected_components(adjacency, connection="strong")
    order = np.argsort(label, kind="stable")
    ends = np.searchsorted(label[order], np.arange(1, count))
    return tuple(sorted(tuple(part.tolist()) for part in np.split(order, ends)))


def require_connected(adjacency: Adjacency) -> None:
    """Raises ValueError that names the parts of a graph (n, n) unless it is in one piece."""
    parts = components(adjacency)
    if len(parts) > 1:
        named = "; ".join(_abbreviated(part) for part in parts[:8])
        more = f"; and {len(parts) - 8} more" if len(parts) > 8 else ""
        cannot = "cannot hear each other" if is_symmetric(adjacency) else "do not all hear all"
        raise ValueError(
            f"the graph is in {len(parts)} pieces that {cannot} ({named}{more}); "
            "add links to the graph or its file, or raise the radio range of a geometric one"
        )


def cut_nodes(adjacency: Adjacency) -> tuple[int, ...]:
    """Nodes whose loss leaves more parts than there were; ascending."""
    if is_symmetric(adjacency):
        return tuple(sorted(networkx.articulation_points(_undirected(adjacency))))
    before = len(components(adjacency))
    alone = {part[0] for part in components(adjacency) if len(part) == 1}
    everyone = np.arange(nodes_of(adjacency))

    def parts_without(node: int) -> int:
        rest = np.delete(everyone, node)
        return _strong_parts(adjacency[rest][:, rest]) if len(rest) else 0

    return tuple(i for i in everyone.tolist() if parts_without(i) > before - (i in alone))


def cut_links(adjacency: Adjacency) -> tuple[tuple[int, int], ...]:
    """Links whose loss leaves more parts than there were: bridges, each as its ends ascending; in a
    directed graph each as (who hears, who is heard)."""
    if is_symmetric(adjacency):
        bridges = networkx.bridges(_undirected(adjacency))
        return tuple(sorted((min(ends), max(ends)) for ends in bridges))
    return tuple(_directed_cut_links(adjacency))


def _directed_cut_links(adjacency: Adjacency) -> Iterator[tuple[int, int]]:
    before = _strong_parts(adjacency)
    hearer, heard = links_of(adjacency)
    for link, ends in enumerate(zip(hearer.tolist(), heard.tolist(), strict=True)):
        kept = np.delete(np.arange(len(hearer)), link)
        ones = np.ones(len(kept), dtype=bool)
        rest = csr_array((ones, (hearer[kept], heard[kept])), shape=adjacency.shape)
        if _strong_parts(rest) > before:
            yield ends


def _strong_parts(adjacency: Adjacency) -> int:
    return connected_components(adjacency, connection="strong", return_labels=False)


def _undirected(adjacency: Adjacency) -> networkx.Graph:
    graph = networkx.empty_graph(nodes_of(adjacency))
    graph.add_edges_from(np.stack(links_of(adjacency), axis=-1).tolist())
    return graph


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


def _abbreviated(part: tuple[int, ...]) -> str:
    shown = ", ".join(map(str, part[:12]))
    return f"nodes {shown}, ... ({len(part)})" if len(part) > 12 else f"nodes {shown}"


# All sets of so many nodes are looked at; deciding it is as hard as that.
EXACT_NODES = 16


def is_robust(neighbours: Sequence[Sequence[int]], reach: int) -> bool | None:
    """Return whether a graph is `reach`-robust, whose nodes hear these; None where it is not known.

    It is known for up to `EXACT_NODES` nodes, for degrees of half of the nodes and more, and where
    a node hears too few.
    """
    nodes = len(neighbours)
    least = min((len(heard) for heard in neighbours), default=0)
    if reach <= 0 or nodes <= 1:
        return reach <= 0
    if reach > (nodes + 1) // 2 or (reach > 1 and least < reach):
        return False
    if least >= nodes // 2 + reach - 1:
        return True
    return _is_robust(neighbours, reach) if nodes <= EXACT_NODES else None


def _is_robust(neighbours: Sequence[Sequence[int]], reach: int) -> bool:
    """Check all sets of nodes; each set is a number whose bits mark its nodes."""
    nodes = len(neighbours)
    sets = np.arange(1 << nodes, dtype=np.uint32)
    shut = sets > 0
    for node, heard in enumerate(neighbours):
        mask = np.uint32(sum(1 << neighbour for neighbour in heard))
        inside = (sets >> np.uint32(node)) & 1
        outside = np.bitwise_count(mask & ~sets)
        shut &= (inside == 0) | (outside < reach)
    # Whether a set or a part of it is shut: one node more at a time.
    holds_shut = shut.copy().reshape((2,) * nodes)
    for axis in range(nodes):
        without, with_node = np.take(holds_shut, 0, axis), np.take(holds_shut, 1, axis)
        holds_shut = np.stack((without, without | with_node), axis=axis)
    rest = sets ^ np.uint32((1 << nodes) - 1)
    return not (shut & holds_shut.reshape(-1)[rest]).any()
