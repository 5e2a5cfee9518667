"""The links of a run: they lose frames, fail, switch, or follow nodes that move.

Everything follows from the setup and is a pure function of (step or cycle, sender, receiver), so
every driver asks for itself and gets the same answer.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.nodes.faults.losses import LinkState, LinkUp, chance
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup, key_of
from concord.topology.link_names import LinkPlan, parse_links
from concord.topology.names import is_file_name
from concord.topology.time_varying import bernoulli, in_range, markov, switching, wandering

if TYPE_CHECKING:
    from concord.topology.adjacency import Adjacency
    from concord.topology.network import Network

# Time-varying links ask for the two steps before the first; counters begin at 0.
_FIRST_COUNT = 2


def link_state(setup: Setup) -> LinkState:
    """Return the effect of a setup's links on frames."""
    scenario = setup.scenario
    losses: dict[tuple[int, int], float] = {}
    if setup.losses is not None:
        # The loss of one link and the loss of all links are independent.
        losses = {
            (sender, receiver): 1 - (1 - own) * (1 - scenario.network.loss)
            for receiver, heard in enumerate(setup.neighbours)
            for sender, own in zip(heard, setup.losses[receiver], strict=True)
        }
    return LinkState(
        key_of(scenario, "links"), scenario.network.loss, losses, link_up=link_up(setup)
    )


def link_up(setup: Setup) -> LinkUp | None:
    """(step, sender, receiver) -> whether there is a link; None where links stay."""
    plan = parse_links(setup.scenario.network.links)
    match plan.kind:
        case "bernoulli":
            return bernoulli(plan.numbers[0], draw_of(setup.scenario))
        case "markov":
            return markov(plan.numbers[0], plan.numbers[1], draw_of(setup.scenario))
        case "switching":
            assert setup.phases is not None, "prepare fills in what switching takes"
            return switching(setup.phases, int(plan.numbers[0]))
        case "moving":
            return in_range(places(setup.scenario, plan), plan.numbers[0])
    return None


def draw_of(scenario: Scenario) -> Callable[[Any, Any, Any], Any]:
    """(step, one, other) -> numbers in [0, 1) that belong to the run, by counting."""
    key = key_of(scenario, "link states")
    return lambda step, one, other: chance(key, np.add(step, _FIRST_COUNT), one, other)


def places(scenario: Scenario, plan: LinkPlan) -> np.ndarray:
    """Where the nodes are in each step, (steps, N, 2) in m.

    Raises:
        ValueError: the plant has no places.
    """
    plant = definition_of(scenario).plant(scenario)
    there = [plant.positions(step) for step in range(scenario.steps)]
    if there[0] is None:
        raise ValueError(
            f"--links {scenario.network.links}: the nodes of scenario {scenario.name} have no "
            "places; use bernoulli, markov or switching, or scenario target-tracking"
        )
    homes = np.stack([np.asarray(place)[:, :2] for place in there if place is not None])
    if len(plan.numbers) == 1:
        return homes
    _, wander, period = plan.numbers
    # All runs of a seed have one network.
    draw = draw_of(msgspec.structs.replace(scenario, run=0))
    offsets = wandering(np.zeros_like(homes[0]), wander, period, len(homes), draw)
    return homes + offsets


def require_static_links(scenario: Scenario, asked: str) -> None:
    """Refuse a change of the graph where links follow graphs of their own.

    Raises:
        ValueError: naming what was asked, the links, and the cure.
    """
    links = scenario.network.links
    if links != "static":
        raise ValueError(f"{asked}: --links {links} brings its own graph; leave one of the two out")


def network_of(
    scenario: Scenario, build: "Callable[[str], Network]"
) -> "tuple[Network, tuple[Adjacency, ...]]":
    """The network of a scenario and the graphs that it switches among.

    A node's neighbours are all nodes that it hears in some step: where graphs take turns or nodes
    move, the result is the union.

    Args:
        build: the network of a graph's name.

    Raises:
        ValueError: links that cannot be on this graph or plant.
    """
    # Only here: a process of the network is handed the graph and need not know how to draw it.
    from concord.topology.adjacency import union
    from concord.topology.network import Network

    plan = parse_links(scenario.network.links)
    if plan.kind == "switching":
        graphs = tuple(build(name).adjacency for name in plan.graphs)
        return Network(union(graphs)), graphs
    if plan.kind == "moving":
        from concord.topology.geometric_graphs import geometric

        reach, there = plan.numbers[0], places(scenario, plan)
        return Network(union([geometric(place, reach) for place in there])), ()
    network = build(scenario.network.graph)
    if plan.kind == "measured" and network.delivery is None:
        raise ValueError(
            f"--links measured: graph {scenario.network.graph} has no chances of delivery; take a "
            "file with numbers between 0 and 1 on its links, a graph of recorded links, or --links "
            "bernoulli:0.1"
        )
    return network, ()


def graph_notes(scenario: Scenario) -> tuple[str, ...]:
    """How the file of a scenario's graph was read and what of it is not used, a sentence each."""
    # Only here: a process of the network reads no graph.
    from concord.topology.graphs import build_network

    name, links = scenario.network.graph, parse_links(scenario.network.links).kind
    if not is_file_name(name) or links in ("switching", "moving"):
        return ()
    network = build_network(name, scenario.nodes, scenario.seed)
    notes = list(network.notes)
    file = name.partition(":")[2]
    if network.delivery is not None and links != "measured":
        notes.append(
            f"{file}: the chances of delivery on its links are not used; --links measured uses them"
        )
    if network.positions is not None:
        notes.append(
            f"{file}: the positions of its nodes are not used, as the nodes of {scenario.name} "
            "have those of its plant; `concord topology show` draws them"
        )
    return tuple(notes)


def losses_of(
    scenario: Scenario, network: "Network", neighbours: list[list[int]]
) -> list[list[float]] | None:
    """Per node, the chance that a frame of each neighbour is lost; None unless it is measured."""
    if parse_links(scenario.network.links).kind != "measured":
        return None
    assert network.delivery is not None, "network_of has looked"
    ends = np.cumsum([len(heard) for heard in neighbours])[:-1]
    return [losses.tolist() for losses in np.split(1 - network.delivery, ends)]
