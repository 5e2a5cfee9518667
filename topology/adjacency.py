"""The matrix of a graph: sparse, boolean, nothing on its diagonal; and how to draw a connected one.

Entry (i, j) says that node i hears node j. Nothing here is dense: memory and time go with the
number of links.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import networkx
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

Adjacency = csr_array

ATTEMPTS = 1000

Drawn = TypeVar("Drawn")


def adjacency_of(graph: networkx.Graph) -> Adjacency:
    """Boolean (n, n) of an undirected graph, nodes in sorted order, self-loops left out."""
    index = {node: number for number, node in enumerate(sorted(graph))}
    ends = np.array([(index[a], index[b]) for a, b in graph.edges()], dtype=int).reshape(-1, 2)
    return both_ways(len(index), ends[:, 0], ends[:, 1])


def from_links(nodes: int, hearer: ArrayLike, heard: ArrayLike) -> Adjacency:
    """Boolean (nodes, nodes) in which `hearer` (links,) hears `heard` (links,).

    Repeated links count once, links of a node to itself are left out.
    """
    rows, columns = np.asarray(hearer, dtype=int), np.asarray(heard, dtype=int)
    true = rows != columns
    ones = np.ones(int(true.sum()), dtype=np.int8)
    summed = coo_array((ones, (rows[true], columns[true])), shape=(nodes, nodes)).tocsr()
    return csr_array(summed, dtype=bool)


def both_ways(nodes: int, one: ArrayLike, other: ArrayLike) -> Adjacency:
    """Boolean (nodes, nodes) in which `one` (links,) and `other` (links,) hear each other."""
    one, other = np.asarray(one, dtype=int), np.asarray(other, dtype=int)
    return from_links(nodes, np.concatenate((one, other)), np.concatenate((other, one)))


def union(graphs: Sequence[Adjacency]) -> Adjacency:
    """Return the graph (n, n) of all links of graphs with the same nodes."""
    hearer, heard = zip(*(links_of(graph) for graph in graphs), strict=True)
    return from_links(nodes_of(graphs[0]), np.concatenate(hearer), np.concatenate(heard))


def links_of(adjacency: Adjacency) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the receivers (links,) and senders (links,), ordered by receiver, then sender."""
    entries = csr_array(adjacency).tocoo()
    order = np.lexsort((entries.col, entries.row))
    return entries.row[order].astype(np.intp), entries.col[order].astype(np.intp)


def entries(matrix: csr_array, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray:
    """Return the entries (k,) of a sparse matrix at rows (k,) and columns (k,)."""
    # scipy answers an empty question with another type.
    return np.asarray(matrix[rows, columns]).ravel() if len(rows) else np.zeros(0, matrix.dtype)


def neighbours_of(adjacency: Adjacency) -> list[list[int]]:
    """Whom each node hears, ascending."""
    hearer, heard = links_of(adjacency)
    ends = np.searchsorted(hearer, np.arange(1, nodes_of(adjacency)))
    return [part.tolist() for part in np.split(heard, ends)]


def nodes_of(matrix: Any) -> int:
    """Return how many nodes a graph or its weights (n, n) have."""
    return matrix.shape[0]


def degrees(adjacency: Adjacency) -> NDArray[np.int64]:
    """Return how many others each node (n,) hears."""
    return np.asarray(adjacency.sum(axis=1, dtype=np.int64)).ravel()


def is_symmetric(adjacency: Adjacency) -> bool:
    """Return whether every link has its opposite."""
    return one_way_links(adjacency).shape[0] == 0


def one_way_links(adjacency: Adjacency) -> NDArray[np.intp]:
    """Links (k, 2) of hearer and heard whose heard does not hear back, by hearer and heard."""
    counts = csr_array(adjacency, dtype=np.int8)
    return np.stack(links_of((counts - counts.T) > 0), axis=-1)


def require_nodes(nodes: int, what: str) -> None:
    """Raises ValueError for a graph without nodes."""
    if nodes < 1:
        raise ValueError(f"{what} of {nodes} nodes: it needs at least 1; ask for more nodes")


def is_connected(adjacency: Adjacency) -> bool:
    """Return whether every node of a graph (n, n) reaches every other, taking links both ways."""
    return connected_components(adjacency, directed=False, return_labels=False) == 1


def first_accepted(
    draw: Callable[[np.random.Generator], Drawn],
    accept: Callable[[Drawn], bool],
    seed: int,
    what: str,
) -> Drawn:
    """Return the first of at most `ATTEMPTS` draws from the stream of `seed` that is accepted.

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
