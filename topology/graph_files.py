"""Graphs in files: edge lists, GraphML and adjacency matrices, told apart by the file's suffix.

| suffix | content |
|---|---|
| .edges .edgelist .txt | two nodes per line, sender first where it matters, and a number if you |
|                       | like (0 for no link); a node without links stands alone on its line; |
|                       | `#` begins a comment |
| .csv                  | the matrix itself: one row per line, 0 or a positive number per entry; |
|                       | entry (i, j) says that i hears j |
| .graphml              | GraphML; an edge leads from sender to receiver; the nodes'         |
|                       | attributes `x` and `y` are their places |

Numbers on links, `delivery` in GraphML, are the chance that a frame arrives if all lie between 0
and 1; others only say that there is a link. A link of an undirected graph that is given one way
goes both ways; matrices and directed GraphML must have both. Nodes are numbered from 0. In GraphML
other names are numbered in their order in the file.
"""

from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from concord.topology.adjacency import is_symmetric, nodes_of, one_way_links
from concord.topology.edge_lists import read_edge_list, read_matrix, write_edge_list, write_matrix
from concord.topology.network import Network, delivery_of

_SUFFIXES = (".edges", ".edgelist", ".txt", ".csv", ".graphml")


def read_network(file: str | Path, nodes: int | None = None, *, directed: bool = False) -> Network:
    """Return the network of a file; of links that go one way if `directed`.

    Raises:
        ValueError: if the file is missing, malformed, has one-way links unless `directed`, or has
            another number of nodes than asked; the message names the file, the line where there is
            one, and the cure.
    """
    file = Path(file)
    suffix = _known_suffix(file)
    if not file.is_file():
        raise ValueError(f"{file}: no such file; check the path")
    names: tuple[str, ...] | None = None
    positions: np.ndarray | None = None
    if suffix == ".graphml":
        from concord.topology.graphml import read_graphml  # only here: it loads networkx

        given, positions, names = read_graphml(file)
    elif suffix == ".csv":
        given = read_matrix(file)
    else:
        given = read_edge_list(file, directed)
    count = nodes_of(given)
    if not count:
        raise ValueError(f"{file}: no nodes; give at least one")
    if nodes is not None and count != nodes:
        raise ValueError(
            f"{file}: {count} nodes, but {nodes} were asked for; "
            f"ask for {count} nodes or change the file"
        )
    adjacency = csr_array(given > 0)
    if not directed and not is_symmetric(adjacency):
        one, other = one_way_links(adjacency)[0]
        called = names or tuple(map(str, range(count)))
        raise ValueError(_one_way(file, called[one], called[other]))
    return Network(adjacency, delivery_of(adjacency, given), positions, names)


def write_network(file: str | Path, network: Network) -> None:
    """Writes a network so that `read_network` returns it; edge lists and matrices hold neither
    places nor names. Raises ValueError for the suffix."""
    file = Path(file)
    suffix = _known_suffix(file)
    if suffix == ".graphml":
        from concord.topology.graphml import write_graphml

        write_graphml(file, network)
    elif suffix == ".csv":
        write_matrix(file, network)
    else:
        write_edge_list(file, network)


def _known_suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(
            f"{file}: unknown kind of graph file {suffix!r}; rename it to end in one of "
            f"{', '.join(_SUFFIXES)}"
        )
    return suffix


def _one_way(where: Path, one: str, other: str) -> str:
    return (
        f"{where}: {one} hears {other}, but {other} does not hear {one}; give each link both ways, "
        "or ask for a directed graph"
    )
