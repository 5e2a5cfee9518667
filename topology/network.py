"""A graph with what is known of it: how well links deliver, where nodes are, their names."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from concord.topology.adjacency import Adjacency, entries, links_of, nodes_of


class Network(NamedTuple):
    """A graph (n, n).

    delivery: chance (links,) that a frame of who is heard reaches who hears, in the order of
    `links_of`; None where nothing is known. positions: (n, 2), None where there are none.
    names: what its source calls the nodes, None for 0, 1, 2, ... notes: what a user must know of
    how its file was read, a sentence each.
    """

    adjacency: Adjacency
    delivery: np.ndarray | None = None
    positions: np.ndarray | None = None
    names: tuple[str, ...] | None = None
    notes: tuple[str, ...] = ()


class GraphSource(NamedTuple):
    """A kind of graph that a user reads from a folder of recorded data.

    Attributes:
        name: of the data.
        read: (folder, number of nodes or None for all) -> the graph; raises ValueError.
        files: that tell a folder of this kind.
        variable: of the environment, which may name such a folder.
    """

    name: str
    read: Callable[[str, int | None], Network]
    files: tuple[str, ...]
    variable: str

    def is_at(self, folder: Path) -> bool:
        """Return whether a folder holds all files that tell this kind."""
        return all((folder / file).is_file() for file in self.files)


def delivery_of(adjacency: Adjacency, given: csr_array) -> np.ndarray | None:
    """The entries of a matrix (n, n) on the links of a graph, as chances; None where none of them
    says more than that there is a link, or some are no chances."""
    values = entries(given, *links_of(adjacency))
    told = len(values) and (values <= 1).all() and (values < 1).any()
    return values if told else None


def part_of(network: Network, kept: NDArray[np.intp]) -> Network:
    """Return the network of some of the nodes (m,), in their order."""
    adjacency, delivery, positions, names, notes = network
    inner = adjacency[kept][:, kept]
    inner_delivery = None
    if delivery is not None:
        nodes = nodes_of(adjacency)
        values = csr_array((delivery, links_of(adjacency)), shape=(nodes, nodes))
        inner_delivery = entries(values[kept][:, kept], *links_of(inner))
    return Network(
        inner,
        inner_delivery,
        None if positions is None else positions[kept],
        None if names is None else tuple(names[i] for i in kept),
        notes,
    )
