"""The matrix of a graph (symmetric, boolean, zero diagonal), and how to draw a connected one."""

from collections.abc import Callable

import networkx
import numpy as np
from numpy.typing import NDArray

Adjacency = NDArray[np.bool_]

ATTEMPTS = 1000


def adjacency_of(graph: networkx.Graph) -> Adjacency:
    """Boolean (n, n) of an undirected graph, nodes in sorted order, self-loops left out."""
    adjacency = networkx.to_numpy_array(graph, nodelist=sorted(graph)) > 0
    np.fill_diagonal(adjacency, False)
    return adjacency


def require_nodes(nodes: int, what: str) -> None:
    """Raises ValueError for a graph without nodes."""
    if nodes < 1:
        raise ValueError(f"{what} of {nodes} nodes: it needs at least 1; ask for more nodes")


def is_connected(adjacency: Adjacency) -> bool:
    """Whether every node of a graph (n, n) reaches every other."""
    return networkx.is_connected(networkx.from_numpy_array(adjacency))


def first_accepted(
    draw: Callable[[np.random.Generator], NDArray],
    accept: Callable[[NDArray], bool],
    seed: int,
    what: str,
) -> NDArray:
    """The first of at most `ATTEMPTS` draws from the stream of `seed` that is accepted.

    Raises:
        ValueError: if none is, with `what` in the message.
    """
    generator = np.random.default_rng(seed)
    for _ in range(ATTEMPTS):
        if accept(drawn := draw(generator)):
            return drawn
    raise ValueError(
        f"{what}: none of {ATTEMPTS} draws was connected; "
        "raise the radius, probability or degree, or add nodes"
    )
