"""Graphs in files: edge lists, GraphML and adjacency matrices, told apart by the file's suffix.

| suffix | content |
|---|---|
| .edges .edgelist .txt | two nodes per line, and a number if you like (no link if it is 0); |
|                       | a node without links stands alone on its line; `#` begins a comment |
| .csv                  | the matrix itself: one row per line, 0 or a positive number per entry |
| .graphml              | GraphML; a directed one must have each link both ways |

`read_directed_graph` takes matrices and GraphML whose links go one way: entry (i, j) of the matrix,
or the edge from j to i, says that i hears j.

Nodes are numbered from 0. In GraphML other names are numbered in their order in the file.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import networkx
import numpy as np

from topology.adjacency import (
    Adjacency,
    both_ways,
    degrees,
    from_links,
    links_of,
    nodes_of,
    one_way_links,
)

_SUFFIXES = (".edges", ".edgelist", ".txt", ".csv", ".graphml")


def read_graph(file: str | Path, nodes: int | None = None) -> Adjacency:
    """The graph of a file as a boolean symmetric (n, n) with zero diagonal.

    Raises:
        ValueError: if the file is missing, malformed, has one-way links, or has another number of
            nodes than asked; the message names the file, the line where there is one, and the cure.
    """
    file = Path(file)
    adjacency, names = _read(file, nodes)
    for one, other in one_way_links(adjacency):
        raise ValueError(_one_way(file, names[one], names[other]))
    return adjacency


def read_directed_graph(file: str | Path, nodes: int | None = None) -> Adjacency:
    """The directed graph of a file as a boolean (n, n) with zero diagonal: (i, j) is "i hears j".

    Raises:
        ValueError: as `read_graph`, but for one-way links.
    """
    adjacency, _ = _read(Path(file), nodes)
    return adjacency


def _read(file: Path, nodes: int | None) -> tuple[Adjacency, list[str]]:
    """The links of a file, one way or both, and what the file calls its nodes."""
    suffix = _known_suffix(file)
    if not file.is_file():
        raise ValueError(f"{file}: no such file; check the path")
    if suffix == ".graphml":
        adjacency, names = _read_graphml(file)
    else:
        adjacency = _read_matrix(file) if suffix == ".csv" else _read_edge_list(file)
        names = [str(node) for node in range(nodes_of(adjacency))]
    if not names:
        raise ValueError(f"{file}: no nodes; give at least one")
    if nodes is not None and len(names) != nodes:
        raise ValueError(
            f"{file}: {len(names)} nodes, but {nodes} were asked for; "
            f"ask for {len(names)} nodes or change the file"
        )
    return adjacency, names


def write_graph(file: str | Path, adjacency: Adjacency) -> None:
    """Writes a graph (n, n) so that `read_graph` returns it. Raises ValueError for the suffix."""
    file = Path(file)
    suffix = _known_suffix(file)
    if suffix == ".graphml":
        networkx.write_graphml(networkx.from_scipy_sparse_array(adjacency.astype(int)), file)
    elif suffix == ".csv":
        np.savetxt(file, adjacency.toarray(), fmt="%d", delimiter=",")
    else:
        pairs = np.stack(links_of(adjacency), axis=-1)
        links = [f"{one} {other}\n" for one, other in pairs if one < other]
        alone = [f"{node}\n" for node in np.flatnonzero(degrees(adjacency) == 0)]
        file.write_text("".join(links + alone))


def _known_suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(
            f"{file}: unknown kind of graph file {suffix!r}; rename it to end in one of "
            f"{', '.join(_SUFFIXES)}"
        )
    return suffix


def _lines(file: Path, separator: str | None) -> Iterator[tuple[str, list[str]]]:
    """`file:line` and the fields of each line that has any; a comment ends a line."""
    text = file.read_text(encoding="utf-8-sig", errors="replace")  # spreadsheets write a mark first
    for number, line in enumerate(text.splitlines(), start=1):
        if content := line.partition("#")[0].strip():
            yield f"{file}:{number}", content.split(separator)


def _read_edge_list(file: Path) -> Adjacency:
    links: list[list[int]] = []
    named: set[int] = set()
    columns = None
    for where, fields in _lines(file, None):
        if len(fields) > 3:
            raise ValueError(
                f"{where}: {len(fields)} columns; give two nodes and at most one number"
            )
        if len(fields) > 1 and len(fields) != (columns := columns or len(fields)):
            raise ValueError(
                f"{where}: {len(fields)} columns, but {columns} on the lines before (cut off?); "
                "give every link a number or none"
            )
        ends = [_node(field, where) for field in fields[:2]]
        named.update(ends)
        if len(ends) == 2 and (len(fields) == 2 or _quality(fields[2], where) > 0):
            if ends[0] == ends[1]:
                raise ValueError(f"{where}: node {ends[0]} is linked to itself; remove the line")
            links.append(ends)
    missing = next(node for node in range(len(named) + 1) if node not in named)
    if missing < len(named):
        raise ValueError(
            f"{file}: node {missing} is missing below node {max(named)}; number the nodes from 0, "
            "and give a node without links a line of its own"
        )
    ends = np.array(links, dtype=int).reshape(-1, 2)
    return both_ways(len(named), ends[:, 0], ends[:, 1])


def _read_matrix(file: Path) -> Adjacency:
    rows = [
        (where, [_quality(field, where) for field in fields]) for where, fields in _lines(file, ",")
    ]
    for where, row in rows:
        if len(row) != len(rows):
            raise ValueError(
                f"{where}: {len(row)} entries in a matrix of {len(rows)} rows; "
                "give a square matrix with one row per node"
            )
    matrix = np.array([row for _, row in rows]).reshape(len(rows), len(rows)) > 0
    for node in np.flatnonzero(matrix.diagonal()):
        raise ValueError(f"{rows[node][0]}: node {node} is linked to itself; put 0 on the diagonal")
    return from_links(len(rows), *np.nonzero(matrix))


def _read_graphml(file: Path) -> tuple[Adjacency, list[str]]:
    try:
        graph = networkx.read_graphml(file)
    except (ElementTree.ParseError, networkx.NetworkXError, ValueError, KeyError) as error:
        raise ValueError(f"{file}: not GraphML ({error}); export the graph again") from error
    names = list(graph)
    if set(names) == {str(number) for number in range(len(names))}:
        names.sort(key=int)
    index = {name: number for number, name in enumerate(names)}
    ends = np.array([(index[one], index[other]) for one, other in graph.edges()], dtype=int)
    sender, hearer = ends.reshape(-1, 2).T
    for node in sender[sender == hearer]:
        raise ValueError(f"{file}: node {names[node]} is linked to itself; remove that edge")
    # What one end of an edge sends, the other hears.
    link = from_links if graph.is_directed() else both_ways
    return link(len(names), hearer, sender), names


def _node(field: str, where: str) -> int:
    if not field.isdecimal():
        raise ValueError(f"{where}: {field!r} is not a node; number the nodes 0, 1, 2, ...")
    return int(field)


def _quality(field: str, where: str) -> float:
    try:
        quality = float(field)
    except ValueError:
        quality = np.nan
    if not 0 <= quality < np.inf:
        raise ValueError(
            f"{where}: {field.strip()!r} is not a finite number of 0 or more; give 0 for no link"
        )
    return quality


def _one_way(where: Path, one: str, other: str) -> str:
    return (
        f"{where}: {one} hears {other}, but {other} does not hear {one}; give each link both ways, "
        "or ask for a directed graph"
    )
