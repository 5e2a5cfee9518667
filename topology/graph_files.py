"""Graphs in files, of the formats in a table by the file's suffix.

| suffix                | content |
|---|---|
| .edges .edgelist .txt | two nodes per line, sender first where it matters, and a number if you |
| .tsv .csv             | like (0 for no link), or a matrix; `edge_lists` tells them apart       |
| .mtx                  | Matrix Market: entry (i, j) says that i hears j                        |
| .graphml .gml .gexf   | an edge leads from sender to receiver; nodes may have places           |
| .net .json            | the same as Pajek, and as node-link JSON of networkx and D3            |

Numbers on links, `delivery` or `weight` of an edge, are the chance that a frame arrives if all lie
between 0 and 1; others only say that there is a link. Links are taken both ways unless one way is
asked for; only a matrix, which writes both, must have both. Nodes with other names than 0, 1, 2,
... are numbered: whole numbers sorted, names in their order.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array

from concord.topology.adjacency import (
    entries,
    links_of,
    nodes_of,
    one_way_links,
)
from concord.topology.edge_lists import (
    read_market,
    read_text,
    write_edge_list,
    write_matrix,
)
from concord.topology.network import Network, delivery_of
from concord.topology.read_graph import Kind, ReadGraph, plain_names


def _read_networkx(file: Path) -> ReadGraph:
    from concord.topology.networkx_files import read_networkx  # only here: it loads networkx

    return read_networkx(file)


def _write_graphml(file: Path, network: Network) -> None:
    from concord.topology.networkx_files import write_graphml

    write_graphml(file, network)


_READERS: dict[str, Callable[[Path], ReadGraph]] = {
    **dict.fromkeys((".graphml", ".gml", ".gexf", ".net", ".json"), _read_networkx),
    **dict.fromkeys((".edges", ".edgelist", ".txt", ".tsv", ".csv"), read_text),
    ".mtx": read_market,
}
_WRITERS: dict[str, Callable[[Path, Network], None]] = {
    ".graphml": _write_graphml,
    **dict.fromkeys((".edges", ".edgelist", ".txt"), write_edge_list),
    ".csv": write_matrix,
}


def read_network(file: str | Path, nodes: int | None = None, *, directed: bool = False) -> Network:
    """Return the network of a file; of links that go one way if `directed`.

    Raises:
        ValueError: naming file, line or element, and cure. The file is missing, malformed, a matrix
            with one-way links unless `directed`, or has another number of nodes than asked.
    """
    file = Path(file)
    found = _read(file)
    count = nodes_of(found.given)
    if not count:
        raise ValueError(f"{file}: no nodes; give at least one")
    if nodes is not None and count != nodes:
        raise ValueError(
            f"{file}: {count} nodes, but {nodes} were asked for; "
            f"ask for {count} nodes (--nodes {count}, or no --nodes) or change the file"
        )
    given, notes = found.given, list(found.notes)
    adjacency = csr_array(given > 0)
    if found.kind is Kind.UNDIRECTED or not directed:
        one_way = one_way_links(adjacency)
        if len(one_way) and found.kind is Kind.MATRIX:
            one, other = (found.names[node] for node in one_way[0])
            raise ValueError(
                f"{file}: {one} hears {other}, but {other} does not hear {one}; give each link "
                f"both ways, or ask for a directed graph as directed:{file}"
            )
        if len(one_way) and found.kind is Kind.DIRECTED:
            notes.append(
                f"{len(one_way)} of its {adjacency.nnz} directed edges have no opposite and are "
                f"taken both ways; directed:{file} takes them one way"
            )
        given = _both_ways(given, one_way)
        adjacency = csr_array(given > 0)
    delivery = delivery_of(adjacency, given)
    if delivery is None:
        notes += _unused_numbers(entries(given, *links_of(adjacency)))
    names = None if list(found.names) == plain_names(count) else found.names
    told = tuple(f"{file}: {note}" for note in notes)
    return Network(adjacency, delivery, found.positions, names, told)


def is_one_way(file: str | Path) -> bool:
    """Return whether a file's links are meant one way.

    A matrix or a directed format tells so by writing some links both ways and others not, or by
    chances of delivery. A list, and a directed format that writes each edge once, does not tell.

    Raises:
        ValueError: as `read_network`.
    """
    found = _read(Path(file))
    adjacency = csr_array(found.given > 0)
    one_way = len(one_way_links(adjacency))
    if not one_way or found.kind in (Kind.LIST, Kind.UNDIRECTED):
        return False
    has_chances = delivery_of(adjacency, found.given) is not None
    return found.kind is Kind.MATRIX or has_chances or one_way < adjacency.nnz


def write_network(file: str | Path, network: Network) -> None:
    """Writes a network so that `read_network` returns it; edge lists and matrices hold neither
    places nor names. Raises ValueError for the suffix."""
    file = Path(file)
    _WRITERS[_suffix(file, _WRITERS, "name it to end in")](file, network)


def _read(file: Path) -> ReadGraph:
    suffix = _suffix(file, _READERS, "export or convert it to")
    if not file.is_file():
        raise ValueError(f"{file}: no such file; check the path")
    return _READERS[suffix](file)


def _suffix(file: Path, known: Iterable[str], cure: str) -> str:
    suffix = file.suffix.lower()
    if suffix not in known:
        raise ValueError(
            f"{file}: unknown kind of graph file {suffix!r}; {cure} one of {', '.join(known)}"
        )
    return suffix


def _both_ways(given: csr_array, one_way: np.ndarray) -> csr_array:
    """Numbers (n, n) in which links (k, 2) that go one way have their number both ways."""
    rows, columns = links_of(given)
    values = entries(given, rows, columns)
    back = entries(given, *one_way.T)
    ends = (np.append(rows, one_way[:, 1]), np.append(columns, one_way[:, 0]))
    return csr_array((np.append(values, back), ends), shape=given.shape)


def _unused_numbers(values: np.ndarray) -> list[str]:
    if not (values != 1).any():
        return []
    return [
        f"the numbers on its links ({values.min():g} to {values.max():g}) are not used: they are "
        "no chances of delivery, which lie between 0 and 1"
    ]
