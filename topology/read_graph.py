"""Graphs as files have them: numbers on links, and names and positions of nodes."""

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array


class Kind(StrEnum):
    """How a file means its links."""

    UNDIRECTED = "undirected"
    DIRECTED = "directed"
    LIST = "list"
    """One way or both ways, as the user asks."""
    MATRIX = "matrix"
    """Both directions are written, so a link with one of them goes one way."""


class ReadGraph(NamedTuple):
    """A graph as its file has it.

    given: number on each link (n, n), entry (i, j) for i hears j. names: (n,), the file's own names
    of its nodes. positions: (n, 2), None unless all nodes have one. notes: what a user must know.
    """

    given: csr_array
    names: tuple[str, ...]
    kind: Kind
    positions: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def from_edges(
    labels: Iterable[str], edges: Iterable[tuple[str, str, float]], kind: Kind
) -> ReadGraph:
    """Return the graph of edges (sender, receiver, number) between nodes with different labels.

    Whole numbers as labels are sorted, other labels keep their order. An edge from a node to itself
    is left out, and a note says so.
    """
    names = list(labels)
    if all(name.removeprefix("-").isdecimal() for name in names):
        names.sort(key=int)
    index = {name: number for number, name in enumerate(names)}
    edges = list(edges)
    loops = [sender for sender, receiver, _ in edges if sender == receiver]
    links = {
        (index[receiver], index[sender]): number
        for sender, receiver, number in edges
        if sender != receiver
    }
    ends = np.array(list(links), dtype=int).reshape(-1, 2)
    values = np.array(list(links.values()), dtype=float)
    given = csr_array((values, (ends[:, 0], ends[:, 1])), shape=(len(names), len(names)))
    notes = () if names == plain_names(len(names)) else (_numbering(names),)
    if loops:
        said = f"{len(loops)} of its edges lead from a node to itself, as at {loops[0]}"
        notes = (*notes, f"{said}; they are left out, for a node always has its own belief")
    return ReadGraph(given, tuple(names), kind, notes=notes)


def plain_names(nodes: int) -> list[str]:
    """Return the names of nodes that have none: 0, 1, 2, ..."""
    return [str(number) for number in range(nodes)]


def _numbering(names: list[str]) -> str:
    last = len(names) - 1
    return f"its nodes are numbered in order, from 0 for {names[0]} to {last} for {names[-1]}"
