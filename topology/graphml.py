"""Graphs as GraphML, by networkx: an edge leads from sender to receiver."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import networkx
import numpy as np
from scipy.sparse import csr_array

from concord.topology.adjacency import is_symmetric, links_of, nodes_of
from concord.topology.network import Network


def read_graphml(file: Path) -> tuple[csr_array, np.ndarray | None, tuple[str, ...]]:
    """The numbers on the links (n, n), entry (i, j) for i hears j; the places (n, 2) of the nodes,
    None unless all have one; and what the file calls them.

    Raises:
        ValueError: naming file and cure.
    """
    try:
        graph = networkx.read_graphml(file)
    except (ElementTree.ParseError, networkx.NetworkXError, ValueError, LookupError) as error:
        raise ValueError(f"{file}: not GraphML ({error}); export the graph again") from error
    names = list(graph)
    if set(names) == {str(number) for number in range(len(names))}:
        names.sort(key=int)
    index = {name: number for number, name in enumerate(names)}
    for name in networkx.nodes_with_selfloops(graph):
        raise ValueError(f"{file}: node {name} is linked to itself; remove that edge")
    links: dict[tuple[int, int], float] = {}
    for one, other, number in graph.edges(data="delivery", default=1.0):
        links[index[other], index[one]] = _quality(number, one, other, file)
        if not graph.is_directed():
            links[index[one], index[other]] = links[index[other], index[one]]
    ends = np.array(list(links), dtype=int).reshape(-1, 2)
    values = np.array(list(links.values()), dtype=float)
    given = csr_array((values, (ends[:, 0], ends[:, 1])), shape=(len(names), len(names)))
    return given, _places(graph, names), tuple(names)


def write_graphml(file: Path, network: Network) -> None:
    """Writes GraphML that `read_graphml` reads back; directed where links go one way, or deliver
    differently in their two directions."""
    adjacency, delivery, positions, names = network
    directed = delivery is not None or not is_symmetric(adjacency)
    graph = networkx.DiGraph() if directed else networkx.Graph()
    called = names or tuple(map(str, range(nodes_of(adjacency))))
    for node, name in enumerate(called):
        place = {} if positions is None else dict(zip("xy", positions[node].tolist(), strict=True))
        graph.add_node(name, **place)
    for link, (i, j) in enumerate(zip(*links_of(adjacency), strict=True)):
        graph.add_edge(called[j], called[i])
        if delivery is not None:
            graph[called[j]][called[i]]["delivery"] = float(delivery[link])
    networkx.write_graphml(graph, file)


def _places(graph: networkx.Graph, names: list[str]) -> np.ndarray | None:
    places = [(graph.nodes[name].get("x"), graph.nodes[name].get("y")) for name in names]
    if any(not isinstance(value, int | float) for place in places for value in place):
        return None
    return np.array(places, dtype=float).reshape(-1, 2)


def _quality(number: Any, one: str, other: str, file: Path) -> float:
    if isinstance(number, int | float) and 0 < number < np.inf:
        return float(number)
    raise ValueError(
        f"{file}: delivery {number!r} from {one} to {other} is not a finite number above 0; give "
        "the chance that a frame arrives, and no edge where none does"
    )
