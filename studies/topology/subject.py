"""Subject of the `concord topology` commands: a graph, its weights and its links."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.sparse import csr_array

from concord.entries import chosen, entries
from concord.scenarios.catalogue import definition_of
from concord.scenarios.links import graph_notes, link_up
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import Ideal
from concord.topology.adjacency import (
    Adjacency,
    from_links,
    is_symmetric,
    links_of,
    nodes_of,
    union,
)
from concord.topology.analysis import require_connected
from concord.topology.graph_files import is_one_way
from concord.topology.graphs import build_network
from concord.topology.link_names import LinkPlan, parse_links
from concord.topology.network import Network
from concord.topology.weights import build_weights, from_per_node

_DEFAULT_NODES = 20


@dataclass(frozen=True, kw_only=True)
class SubjectOptions:
    """Options left out take what the graph suggests, or the scenario's own."""

    scenario: str | None = None
    """Take graph, places and plant of this scenario; `concord list` names them."""
    nodes: int | None = None
    """Number of nodes (20)."""
    weights: str | None = None
    """Weights: metropolis, maximum-degree, best-constant, fastest-mixing; equal-neighbour for
    links that go one way."""
    links: str | None = None
    """Behaviour of links: static, measured (by the file's own chances), bernoulli:0.1,
    markov:0.05,0.3, switching:ring,star:10; with a scenario also moving:300."""
    seed: int = 1
    """Seed of everything random."""
    data: Path | None = None
    """Folder of recorded links, or of the scenario's data."""


class Subject(NamedTuple):
    """A graph under weights (n, n).

    `setup` where it comes from a scenario; `phases` are the graphs that follow each other and begin
    again, one per step, where links switch or nodes move.
    """

    name: str
    weights_name: str
    links: str
    network: Network
    weights: csr_array
    setup: Setup | None
    phases: tuple[Adjacency, ...] = ()

    @property
    def plan(self) -> LinkPlan:
        """Return the behaviour of the links."""
        return parse_links(self.links)


def subject_of(source: str, options: SubjectOptions, *, connected: bool = False) -> Subject:
    """Return the subject that source and options mean.

    Args:
        source: a graph's name, a graph file, or a folder of recorded links; "" for the scenario's
            own graph.
        connected: refuse a graph in pieces.

    Raises:
        ValueError: anything that cannot be, with value, rule and cure.
    """
    if options.scenario is not None:
        return _of_scenario(source, options)
    asked = parse_links(options.links or "static")
    if not source and not asked.graphs:
        raise ValueError(
            "which graph? Give a name (ring, geometric, ...), a graph file, a folder of recorded "
            "links, or --scenario"
        )
    turns = tuple(_network(name, options).adjacency for name in asked.graphs)
    network = Network(union(turns)) if turns else _network(source, options)
    if connected:
        require_connected(network.adjacency)
    symmetric = is_symmetric(network.adjacency)
    weights_name = options.weights or ("metropolis" if symmetric else "equal-neighbour")
    links = options.links or ("static" if network.delivery is None else "measured")
    plan = parse_links(links)
    if plan.kind == "measured" and network.delivery is None:
        raise ValueError(
            f"links measured: graph {source} has no chances of delivery; take a file with numbers "
            "between 0 and 1 on its links, recorded links, or links bernoulli:0.1"
        )
    if plan.kind == "moving":
        raise ValueError(
            f"links {links}: nodes move with a scenario's plant; add --scenario, for example "
            "target-tracking"
        )
    weights = build_weights(weights_name, network.adjacency)
    phases = tuple(turn for turn in turns for _ in range(int(asked.numbers[0])))
    return Subject(source or links, weights_name, links, network, weights, None, phases)


def graph_name(source: str) -> str:
    """Return the graph's name for a source: files and folders are looked at for what they are."""
    path = Path(source)
    if path.is_dir():
        kinds = {name: chosen("GRAPHS", name) for name in entries("GRAPHS")}
        # Where several graphs are read from a folder, the last of the table has most of its links.
        for name, kind in reversed(kinds.items()):
            if kind.is_at(path):
                return f"{name}:{source}"
        known = {
            f"{kind.name} data, which holds {' and '.join(kind.files)}" for kind in kinds.values()
        }
        raise ValueError(
            f"{source}: no folder of {' or '.join(sorted(known)) or 'recorded links'}; give such a "
            "folder, a graph file, or the name of a graph"
        )
    if path.is_file():
        return f"directed:{source}" if is_one_way(path) else f"file:{source}"
    if (path.suffix or len(path.parts) > 1) and ":" not in source:
        raise ValueError(
            f"{source}: there is no such file or folder; give a graph file, a folder of recorded "
            "links, or the name of a graph"
        )
    return source


def _network(source: str, options: SubjectOptions) -> Network:
    name = graph_name(source)
    read = ":" in name or name in entries("GRAPHS")
    nodes = options.nodes if read or options.nodes is not None else _DEFAULT_NODES
    return build_network(name, nodes, options.seed, data=options.data and str(options.data))


def _with_data(name: str, data: Path | None) -> str:
    """Return the name of a graph that is read from a folder of data, with that folder."""
    return f"{name}:{data}" if data is not None and name in entries("GRAPHS") else name


def _of_scenario(source: str, options: SubjectOptions) -> Subject:
    assert options.scenario is not None
    asked = {
        "nodes": options.nodes,
        "graph": _with_data(graph_name(source), options.data) if source else None,
        "weights": options.weights,
        "links": options.links,
        "seed": options.seed,
    }
    said = {name: value for name, value in asked.items() if value is not None}
    # These commands analyse the graph only, so no bus needs room for it.
    setup = prepare(msgspec.structs.replace(scenario_of(options.scenario, **said), bus=Ideal()))
    scenario = setup.scenario
    neighbours = setup.neighbours
    adjacency = from_links(len(neighbours), *setup.links)
    positions = definition_of(scenario).plant(scenario).positions(0)
    delivery: np.ndarray | None = None
    if setup.losses is not None:
        delivery = 1 - np.array([loss for losses in setup.losses for loss in losses])
    places = None if positions is None else positions[:, :2]
    network = Network(adjacency, delivery, places, notes=graph_notes(scenario))
    weights = from_per_node(setup.weights, neighbours)
    phases = _phases(setup, adjacency)
    return Subject(
        scenario.network.graph,
        scenario.network.weights,
        scenario.network.links,
        network,
        weights,
        setup,
        phases,
    )


def _phases(setup: Setup, adjacency: Adjacency) -> tuple[Adjacency, ...]:
    """Return the graph of each step of a scenario in which graphs take turns or nodes move."""
    plan = parse_links(setup.scenario.network.links)
    up = link_up(setup)
    if up is None or plan.kind not in ("switching", "moving"):
        return ()
    steps = setup.scenario.steps
    if plan.kind == "switching":
        steps = len(plan.graphs) * int(plan.numbers[0])
    hearer, heard = links_of(adjacency)
    found = (np.asarray(up(np.full(len(hearer), k), heard, hearer), bool) for k in range(steps))
    return tuple(from_links(nodes_of(adjacency), hearer[on], heard[on]) for on in found)
