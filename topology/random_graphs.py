"""Random graphs, each determined by its seed alone and connected.

A family that may come out in pieces is drawn again from the same stream until it is whole, so its
law is the usual one given connectedness.
"""

import math
from collections.abc import Callable

import networkx
import numpy as np

from concord.topology.adjacency import (
    Adjacency,
    adjacency_of,
    first_accepted,
    is_connected,
    require_nodes,
)


def regular(nodes: int, degree: int, seed: int) -> Adjacency:
    """Everyone has `degree` neighbours; nearly uniform among such graphs (Steger, Wormald 1999).

    Raises:
        ValueError: if no connected graph with these numbers exists.
    """
    what = f"{degree}-regular graph of {nodes} nodes"
    require_nodes(nodes, f"{degree}-regular graph")
    if not 0 <= degree < nodes or nodes * degree % 2:
        raise ValueError(
            f"{what}: the degree must be below the number of nodes and their product even; "
            "add or take one node, or change the degree"
        )
    if degree < min(nodes - 1, 2):
        raise ValueError(f"{what}: it cannot be connected; choose a degree of 2 or more")
    return _connected(
        lambda generator: networkx.random_regular_graph(degree, nodes, generator), seed, what
    )


def erdos_renyi(nodes: int, probability: float, seed: int) -> Adjacency:
    """Each pair is joined with `probability`, independently of the others.

    Raises:
        ValueError: for an impossible probability, or one so low that no draw was connected.
    """
    what = f"Erdos-Renyi graph of {nodes} nodes with probability {probability:g}"
    require_nodes(nodes, "Erdos-Renyi graph")
    _require_probability(probability, what)
    return _connected(
        lambda generator: networkx.fast_gnp_random_graph(nodes, probability, generator), seed, what
    )


def small_world(nodes: int, degree: int, rewiring: float, seed: int) -> Adjacency:
    """A ring where everyone hears the `degree` nearest, each link rewired with probability
    `rewiring` (Watts and Strogatz 1998).

    Raises:
        ValueError: for a degree that is odd, too small or not below the number of nodes, or an
            impossible probability.
    """
    what = f"small-world graph of {nodes} nodes with degree {degree} and rewiring {rewiring:g}"
    if not 2 <= degree < nodes or degree % 2:
        raise ValueError(
            f"{what}: the degree must be even, at least 2 and below the number of nodes; "
            f"give at least {degree + 1} nodes or change the degree"
        )
    _require_probability(rewiring, what)
    return _connected(
        lambda generator: networkx.watts_strogatz_graph(nodes, degree, rewiring, generator),
        seed,
        what,
    )


def scale_free(nodes: int, links: int, seed: int) -> Adjacency:
    """Nodes arrive one by one and join `links` others, preferring those with many neighbours
    (Barabasi and Albert 1999); always connected.

    Raises:
        ValueError: unless 1 <= links < nodes.
    """
    if not 1 <= links < nodes:
        raise ValueError(
            f"scale-free graph of {nodes} nodes: {links} links per new node must be at least 1 and "
            f"below the number of nodes; give at least {max(links, 1) + 1} nodes"
        )
    generator = np.random.default_rng(seed)
    return adjacency_of(networkx.barabasi_albert_graph(nodes, links, generator))


def connecting_probability(nodes: int) -> float:
    """Probability of a link at which the mean degree is about 2 ln n, twice the threshold of
    connectedness (Erdos and Renyi 1960)."""
    return min(1.0, 2 * math.log(max(nodes, 2)) / max(nodes, 2))


def _connected(
    draw: Callable[[np.random.Generator], networkx.Graph], seed: int, what: str
) -> Adjacency:
    return first_accepted(lambda generator: adjacency_of(draw(generator)), is_connected, seed, what)


def _require_probability(probability: float, what: str) -> None:
    if not 0 <= probability <= 1:
        raise ValueError(f"{what}: a probability lies between 0 and 1; give such a number")
