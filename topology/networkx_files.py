"""Graphs in the formats that networkx reads; an edge leads from sender to receiver.

GraphML, GML, GEXF, Pajek and node-link JSON.
"""

import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import networkx
import numpy as np

from concord.topology.adjacency import is_symmetric, links_of, nodes_of
from concord.topology.network import Network
from concord.topology.read_graph import Kind, ReadGraph, from_edges

EARTH_RADIUS_M = 6_371_008.8
# Attributes of a node that are its place, in the order in which they are looked for.
_PLACES = (("x", "y"), ("longitude", "latitude"), ("lon", "lat"), ("lng", "lat"))


def read_networkx(file: Path) -> ReadGraph:
    """The graph of a file, its format told by the suffix.

    Raises:
        ValueError: naming file, place or element, and cure.
    """
    name, read = READERS[file.suffix.lower()]
    try:
        graph = read(file.read_text(encoding="utf-8-sig", errors="replace"))
    except (ElementTree.ParseError, networkx.NetworkXException, ValueError, LookupError,
            TypeError, AttributeError, RuntimeError, StopIteration) as error:  # fmt: skip
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{file}: not {name} ({why}); export the graph again") from error
    ids = {node: str(node) for node in graph}
    unused: list[str] = []
    edges = [
        (ids[one], ids[other], _number(data, f"{ids[one]} to {ids[other]}", file, unused))
        for one, other, data in graph.edges(data=True)
    ]
    if unused:
        edges = [(one, other, 1.0) for one, other, _ in edges]
    kind = Kind.DIRECTED if graph.is_directed() else Kind.UNDIRECTED
    found = from_edges(ids.values(), edges, kind)
    attributes = {ids[node]: data for node, data in graph.nodes(data=True)}
    labels = tuple(str(attributes[name].get("label") or "").strip() for name in found.names)
    positions, notes = _positions([attributes[name] for name in found.names])
    return found._replace(
        names=labels if all(labels) and len(set(labels)) == len(labels) else found.names,
        positions=positions,
        notes=(*found.notes, *unused[:1], *notes),
    )


def write_graphml(file: Path, network: Network) -> None:
    """Writes GraphML that `read_networkx` reads back; directed where links go one way, or deliver
    differently in their two directions."""
    adjacency, delivery, positions, names = network[:4]
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


def _gml(text: str) -> networkx.Graph:
    # Labels may repeat and edges may be parallel, which networkx takes only where the file says so.
    if "multigraph" not in text:
        text = text.replace("[", "[\n  multigraph 1\n", 1)
    return networkx.parse_gml(text, label="id")


def _gexf(text: str) -> networkx.Graph:
    # Versions differ in their namespace alone as far as graphs go; networkx knows the older ones.
    known = 'xmlns="http://www.gexf.net/1.2draft"'
    text = re.sub(r'xmlns="http://[^"]*gexf[^"]*"', known, text, count=1)
    return networkx.read_gexf(io.BytesIO(text.encode()))


def _pajek(text: str) -> networkx.Graph:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("%")]
    found = next((k for k, line in enumerate(lines) if line.lower().startswith("*vertices")), 0)
    count = (lines or [""])[found].split()[1:2]
    if not count or not count[0].isdecimal():
        raise ValueError("it has no line '*Vertices N'")
    if lines[found + 1 : found + 2] and lines[found + 1].startswith("*"):
        # Pajek lets names be left out, networkx does not.
        lines[found + 1 : found + 1] = [f'{k} "{k}"' for k in range(1, int(count[0]) + 1)]
    graph = networkx.parse_pajek(_in_one_section(lines))
    if len(graph) != int(count[0]):
        raise ValueError(
            f"*Vertices says {count[0]}, and {len(graph)} names are in the file: each vertex needs "
            "a line with its number and a name of its own"
        )
    return graph


def _in_one_section(lines: list[str]) -> list[str]:
    """Pajek with each edge as two arcs where it has both, as networkx reads all links like those of
    the first section.

    Raises:
        ValueError: lists of neighbours, which networkx takes for edges with weights.
    """
    headings = [line.split()[0].lower() for line in lines if line.startswith("*")]
    for heading in headings:
        if heading.endswith("list"):
            raise ValueError(f"a section {heading} is not read; save links as *Arcs or *Edges")
    if not {"*arcs", "*edges"} <= {*headings}:
        return lines
    kept: list[str] = []
    arcs: list[str] = []
    section = ""
    for line in lines:
        section = line.split()[0].lower() if line.startswith("*") else section
        if section not in ("*arcs", "*edges"):
            kept.append(line)
        elif not line.startswith("*"):
            one, other, *rest = line.split()
            arcs.append(line)
            arcs += [" ".join([other, one, *rest])] if section == "*edges" else []
    return [*kept, "*Arcs", *arcs]


def _node_link(text: str) -> networkx.Graph:
    data = json.loads(text)
    edges = next((key for key in ("links", "edges") if key in data), None)
    if not isinstance(data, dict) or "nodes" not in data or edges is None:
        raise ValueError("it has no 'nodes' and 'links' at its top")
    graph = networkx.node_link_graph(data, edges=edges)
    if len(graph) != len(data["nodes"]):
        raise ValueError(
            f"{len(data['nodes'])} entries in 'nodes', but the {edges} name {len(graph)} nodes"
        )
    return graph


READERS: dict[str, tuple[str, Callable[[str], networkx.Graph]]] = {
    ".graphml": ("GraphML", networkx.parse_graphml),
    ".gml": ("GML", _gml),
    ".gexf": ("GEXF", _gexf),
    ".net": ("Pajek", _pajek),
    ".json": ("node-link JSON", _node_link),
}


def _positions(nodes: list[dict[str, Any]]) -> tuple[np.ndarray | None, list[str]]:
    """Places (n, 2) of nodes by their attributes, degrees in m around their mean; and what is to be
    said where only some have one."""
    lower = [{str(key).lower(): value for key, value in data.items()} for data in nodes]
    for across, up in _PLACES:
        places = np.array([[_real(data.get(key)) for key in (across, up)] for data in lower])
        known = int(np.isfinite(places).all(axis=1).sum()) if nodes else 0
        if not known:
            continue
        if known < len(nodes):
            missing = len(nodes) - known
            return None, [f"{missing} of {len(nodes)} nodes have no {across} and {up}, so the "
                          "positions of the others are not used"]  # fmt: skip
        if across == "x":
            return places, []
        middle = places.mean(axis=0)
        radians = np.radians(places - middle)
        return EARTH_RADIUS_M * radians * [np.cos(np.radians(middle[1])), 1.0], []
    return None, []


def _real(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan


def _number(data: dict[str, Any], link: str, file: Path, unused: list[str]) -> float:
    """The number on a link: its `delivery`, or its `weight` where that is one above 0."""
    if (delivery := data.get("delivery")) is not None:
        if isinstance(delivery, int | float) and 0 < delivery < np.inf:
            return float(delivery)
        raise ValueError(
            f"{file}: delivery {delivery!r} from {link} is not a finite "
            "number above 0; give the chance that a frame arrives, and no edge where none does"
        )
    weight = data.get("weight", 1.0)
    if 0 < _real(weight) < np.inf:
        return float(weight)
    unused.append(f"the weights of its edges are not used: {weight!r} from {link} is not a finite "
                  "number above 0")  # fmt: skip
    return 1.0
