"""Graphs of fixed shape, and every graph by its name.

A graph is a sparse boolean matrix `(n, n)` with nothing on its diagonal: entry (i, j) says that
node i hears node j. It is symmetric but where a directed graph is asked for.
"""

import math
import os
import re
from collections.abc import Callable

import networkx
import numpy as np
from numpy.typing import NDArray

from concord.entries import chosen, entries
from concord.topology.adjacency import Adjacency, adjacency_of, both_ways, require_nodes
from concord.topology.edge_text import read_edge_text
from concord.topology.names import graph_names, unknown_name
from concord.topology.network import GraphSource, Network
from concord.topology.random_graphs import (
    connecting_probability,
    erdos_renyi,
    regular,
    scale_free,
    small_world,
)

MOST_COMPLETE = 4000


def ring(nodes: int) -> Adjacency:
    """Every node hears its two neighbours on a circle. Raises ValueError for no nodes."""
    require_nodes(nodes, "ring")
    return adjacency_of(networkx.cycle_graph(nodes))


def path(nodes: int) -> Adjacency:
    """A ring that is cut once. Raises ValueError for no nodes."""
    require_nodes(nodes, "path")
    return adjacency_of(networkx.path_graph(nodes))


def star(nodes: int) -> Adjacency:
    """Node 0 hears everyone, everyone else hears node 0. Raises ValueError for no nodes."""
    require_nodes(nodes, "star")
    return adjacency_of(networkx.star_graph(nodes - 1))


def complete(nodes: int) -> Adjacency:
    """Everyone hears everyone. Raises ValueError for no nodes, or more than `MOST_COMPLETE`."""
    require_nodes(nodes, "complete graph")
    if nodes > MOST_COMPLETE:
        raise ValueError(
            f"complete graph of {nodes} nodes: it has {nodes * (nodes - 1) // 2} links; ask for at "
            f"most {MOST_COMPLETE} nodes, or a graph whose links grow with its nodes"
        )
    return both_ways(nodes, *np.triu_indices(nodes, 1))


def grid(rows: int, columns: int) -> Adjacency:
    """A rectangular lattice numbered row by row. Raises ValueError for an empty side."""
    require_nodes(min(rows, columns), f"grid of {rows} x {columns}: a side")
    return adjacency_of(networkx.grid_2d_graph(rows, columns))


def near_square(nodes: int) -> tuple[int, int]:
    """Return the rows and columns nearest to a square that hold exactly `nodes` nodes.

    Raises:
        ValueError: for a prime number, whose only grid is a path.
    """
    require_nodes(nodes, "grid")
    rows = next(side for side in range(math.isqrt(nodes), 0, -1) if nodes % side == 0)
    if rows == 1 < nodes:
        raise ValueError(
            f"grid of {nodes} nodes: they only fill one row; "
            "choose a number with two factors above 1, or ask for path"
        )
    return rows, nodes // rows


_BUILDERS: dict[str, Callable[[int, int], Adjacency]] = {
    "ring": lambda nodes, seed: ring(nodes),
    "path": lambda nodes, seed: path(nodes),
    "star": lambda nodes, seed: star(nodes),
    "grid": lambda nodes, seed: grid(*near_square(nodes)),
    "complete": lambda nodes, seed: complete(nodes),
    "erdos-renyi": lambda nodes, seed: erdos_renyi(nodes, connecting_probability(nodes), seed),
    "small-world": lambda nodes, seed: small_world(nodes, 4, 0.1, seed),
    "scale-free": lambda nodes, seed: scale_free(nodes, 2, seed),
}


def _read(path: str, nodes: int | None, directed: bool = False) -> Network:
    # Only here: most graphs are drawn.
    from concord.topology.graph_files import read_network

    return read_network(path, nodes, directed=directed)


# The text after the colon is a path, or the edges themselves.
_SOURCES: dict[str, Callable[[str, int | None], Network]] = {
    "edges": lambda text, nodes: Network(read_edge_text(text, nodes)),
    "file": _read,
    "directed": lambda path, nodes: _read(path, nodes, directed=True),
}


def is_random(name: str) -> bool:
    """Return whether the graph of a name depends on the seed."""
    drawn = ("erdos-renyi", "small-world", "scale-free", "geometric")
    return name in drawn or name.endswith("-regular")


def build_graph(
    name: str,
    nodes: int,
    seed: int,
    positions: NDArray[np.float64] | None = None,
    radius: float | None = None,
) -> Adjacency:
    """Return the graph of that name: sparse boolean (nodes, nodes), as `build_network` has it."""
    return build_network(name, nodes, seed, positions, radius).adjacency


def build_network(
    name: str,
    nodes: int | None,
    seed: int,
    positions: NDArray[np.float64] | None = None,
    radius: float | None = None,
    data: str | None = None,
) -> Network:
    """Return the graph of that name and what is known of it.

    `geometric` takes `positions` (nodes, 2) and a `radius` in their unit; without positions it
    draws them by `scatter`. A graph of an entry takes the folder of its `data`, which may also
    follow its name after a colon, or stand in the environment. The other names use none of them.
    `erdos-renyi` has a mean degree of about 2 ln n, `small-world` degree 4 and rewiring 0.1,
    `scale-free` two links per new node. All but `directed:PATH` and some graphs of entries are
    symmetric; there (i, j) says that i hears j. Only what is read may leave `nodes` open.

    Raises:
        ValueError: for an unknown name or impossible numbers.
    """
    source, colon, path_ = name.partition(":")
    if source in entries("GRAPHS"):
        found: GraphSource = chosen("GRAPHS", source)
        folder = path_ or data or os.environ.get(found.variable)
        if not folder:
            raise ValueError(
                f"graph {source} is read from {found.name} data: name their folder as "
                f"{source}:FOLDER, or with the environment variable {found.variable}"
            )
        return found.read(folder, nodes)
    if source in _SOURCES and colon:
        return _SOURCES[source](path_, nodes)
    if nodes is None:
        raise ValueError(f"graph {name}: the number of nodes is open; say how many with --nodes")
    if name == "geometric":
        return _geometric(nodes, seed, positions, radius)
    if match := re.fullmatch(r"([0-9]+)-regular", name):
        return Network(regular(nodes, int(match[1]), seed))
    if name in _BUILDERS:
        return Network(_BUILDERS[name](nodes, seed))
    raise unknown_name("graph", name, graph_names())


def _geometric(
    nodes: int, seed: int, positions: NDArray[np.float64] | None, radius: float | None
) -> Network:
    # Only here: other graphs need no places.
    from concord.topology.geometric_graphs import connecting_radius, geometric, scatter

    if positions is None:
        reach = connecting_radius(nodes) if radius is None else radius
        drawn = scatter(nodes, seed, reach)
        return Network(geometric(drawn, reach), positions=drawn)
    if radius is None:
        raise ValueError("geometric graph: positions without a radius; give the radio range too")
    if len(positions) != nodes:
        raise ValueError(
            f"geometric graph: {len(positions)} positions for {nodes} nodes; give one per node"
        )
    return Network(geometric(positions, radius), positions=positions)
