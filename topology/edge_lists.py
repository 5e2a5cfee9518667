"""Graphs as text: lists of edges and matrices of numbers.

Both are read to a sparse matrix (n, n) whose entry (i, j) is the number on the link by which node i
hears node j, 1 where none is given.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from concord.topology.adjacency import degrees, is_symmetric, links_of, nodes_of
from concord.topology.network import Network

# A matrix as text has a character per pair of nodes at least.
MOST_MATRIX_NODES = 5000


def read_edge_list(file: Path, directed: bool) -> csr_array:
    """The numbers (n, n) of a list; each edge also goes the other way unless `directed`, or unless
    that is on a line of its own.

    Raises:
        ValueError: naming file, line and cure.
    """
    links: dict[tuple[int, int], float] = {}
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
        quality = _quality(fields[2], where) if len(fields) == 3 else 1.0
        if len(ends) == 2 and quality > 0:
            if ends[0] == ends[1]:
                raise ValueError(f"{where}: node {ends[0]} is linked to itself; remove the line")
            links[ends[1], ends[0]] = quality
    missing = next(node for node in range(len(named) + 1) if node not in named)
    if missing < len(named):
        raise ValueError(
            f"{file}: node {missing} is missing below node {max(named)}; number the nodes from 0, "
            "and give a node without links a line of its own"
        )
    if not directed:
        links = {(sender, hearer): quality for (hearer, sender), quality in links.items()} | links
    ends = np.array(list(links), dtype=int).reshape(-1, 2)
    shape = (len(named), len(named))
    return csr_array((np.array(list(links.values())), (ends[:, 0], ends[:, 1])), shape=shape)


def write_edge_list(file: Path, network: Network) -> None:
    """Writes a list that `read_edge_list` reads back."""
    adjacency, delivery = network.adjacency, network.delivery
    hearer, heard = links_of(adjacency)
    once = delivery is None and is_symmetric(adjacency)
    numbers = [""] * len(hearer) if delivery is None else [f" {p:.17g}" for p in delivery]
    lines = [
        f"{sender} {receiver}{number}\n"
        for receiver, sender, number in zip(hearer, heard, numbers, strict=True)
        if not once or sender < receiver
    ]
    silent = (degrees(adjacency) == 0) & (degrees(csr_array(adjacency.T)) == 0)
    alone = [f"{node}\n" for node in np.flatnonzero(silent)]
    file.write_text("".join(lines + alone))


def read_matrix(file: Path) -> csr_array:
    """Return the numbers (n, n) of a matrix.

    Raises:
        ValueError: naming file, line and cure.
    """
    rows = [
        (where, [_quality(field, where) for field in fields]) for where, fields in _lines(file, ",")
    ]
    for where, row in rows:
        if len(row) != len(rows):
            raise ValueError(
                f"{where}: {len(row)} entries in a matrix of {len(rows)} rows; "
                "give a square matrix with one row per node"
            )
    matrix = np.array([row for _, row in rows]).reshape(len(rows), len(rows))
    for node in np.flatnonzero(matrix.diagonal()):
        raise ValueError(f"{rows[node][0]}: node {node} is linked to itself; put 0 on the diagonal")
    return csr_array(matrix)


def write_matrix(file: Path, network: Network) -> None:
    """Writes a matrix that `read_matrix` reads back.

    Raises:
        ValueError: for more than `MOST_MATRIX_NODES` nodes.
    """
    nodes = nodes_of(network.adjacency)
    if nodes > MOST_MATRIX_NODES:
        raise ValueError(
            f"{file}: a matrix of {nodes} nodes has {nodes**2} entries; write .edges or .graphml "
            f"for more than {MOST_MATRIX_NODES} nodes"
        )
    matrix: NDArray = np.zeros((nodes, nodes))
    matrix[links_of(network.adjacency)] = 1 if network.delivery is None else network.delivery
    np.savetxt(file, matrix, fmt="%.17g", delimiter=",")


def _lines(file: Path, separator: str | None) -> Iterator[tuple[str, list[str]]]:
    """`file:line` and the fields of each line that has any; a comment ends a line."""
    text = file.read_text(encoding="utf-8-sig", errors="replace")  # spreadsheets write a mark first
    for number, line in enumerate(text.splitlines(), start=1):
        if content := line.partition("#")[0].strip():
            yield f"{file}:{number}", content.split(separator)


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
