"""Graphs as one word: `edges:0-1;1-2;2>0`, where 2>0 says that node 0 hears node 2 alone."""

import re
from typing import Any

import networkx
import numpy as np

from concord.topology.adjacency import Adjacency, from_links

_EDGE = re.compile(r"(\d+)([->])(\d+)")


def edge_text(graph: Any) -> str:
    """The word for a networkx graph, or for a matrix (n, n) whose entry (i, j) says that i hears j.

    A networkx edge goes from the node that is heard to the node that hears. Parallel edges are one
    link, and a link of a node to itself is none. A matrix may be an array, a sparse matrix of scipy
    or a DataArray.

    Raises:
        ValueError: nodes that are not numbered 0, 1, 2, ..., or a matrix that is not square, or has
            other entries than 0 and 1.
    """
    return sized_edge_text(graph)[0]


def sized_edge_text(graph: Any) -> tuple[str, int]:
    """The word of `edge_text`, and the number of nodes.

    Raises:
        ValueError: as `edge_text`.
    """
    if isinstance(graph, networkx.Graph):
        nodes = len(graph)
        if sorted(map(str, graph)) != sorted(map(str, range(nodes))):
            raise ValueError(
                "the nodes of a graph must be 0, 1, 2, ...; number them with "
                "networkx.convert_node_labels_to_integers(graph)"
            )
        heard = {(int(a), int(b)) for a, b in graph.edges() if a != b}
        heard |= set() if graph.is_directed() else {(b, a) for a, b in heard}
    else:
        matrix = _matrix(graph)
        nodes = len(matrix)
        heard = {(int(j), int(i)) for i, j in np.argwhere(matrix) if i != j}
    both = {(a, b) for a, b in heard if (b, a) in heard}
    words = [f"{a}-{b}" for a, b in sorted(both) if a < b]
    words += [f"{a}>{b}" for a, b in sorted(heard - both)]
    return f"edges:{';'.join(words)}", nodes


def _matrix(graph: Any) -> np.ndarray:
    """The entries (n, n) of a matrix, 0 and 1."""
    try:
        matrix = np.asarray(graph.toarray() if hasattr(graph, "toarray") else graph, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"a graph of type {type(graph).__name__}: must be a name such as ring, file:PATH, a "
            "graph of networkx, or a matrix of 0 and 1"
        ) from None
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise ValueError(f"a graph of shape {matrix.shape}: must be square, a row for each node")
    off = matrix - np.diag(np.diagonal(matrix))
    if (wrong := np.argwhere(~((off == 0) | (off == 1)))).size:
        i, j = wrong[0]
        raise ValueError(
            f"a graph with entry {matrix[i, j]:g} in row {i}, column {j}: must be 0 or 1; write "
            "chances of delivery to a file, and give it as file:PATH.csv with links=measured"
        )
    return off


def read_edge_text(text: str, nodes: int | None) -> Adjacency:
    """The graph (n, n) of the edges in a word, `edges:` left out.

    Raises:
        ValueError: an edge that is none, or a node beyond their number.
    """
    hearer, heard = [], []
    for edge in filter(None, text.split(";")):
        match = _EDGE.fullmatch(edge)
        if match is None or match[1] == match[3]:
            raise ValueError(f"graph edges:{text}: {edge!r} is no edge; write 0-1, or 0>1 one way")
        one, other = int(match[1]), int(match[3])
        heard.append(one)
        hearer.append(other)
        if match[2] == "-":
            heard.append(other)
            hearer.append(one)
    last = max([*hearer, *heard], default=0)
    if nodes is not None and last >= nodes:
        raise ValueError(
            f"graph edges:{text}: it has node {last}, and the network has nodes 0 to {nodes - 1}; "
            f"ask for --nodes {last + 1}"
        )
    return from_links(last + 1 if nodes is None else nodes, hearer, heard)
