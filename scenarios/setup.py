"""A scenario worked out: the graph, the weights and the prior as plain data.

A `Setup` is all that a process of the network is told. It is data and not objects, so that any
process anywhere builds the same node from it, and so that its digest tells whether two processes
agree.
"""

import hashlib
import os
from functools import partial
from importlib.metadata import version

import msgspec
import numpy as np

from filters import compiled
from nodes.bounds import MAX_ROUNDS
from nodes.changes import Settings
from nodes.commands import SETTINGS
from nodes.faults import Equipment
from nodes.messages import to_wire
from scenarios.bus_plan import check_bus, plan_bus
from scenarios.catalogue import kind_of
from scenarios.equipment import equipment_of
from scenarios.links import losses_of, network_of, stream_of
from scenarios.rules import check_rule, is_certain, share_size
from scenarios.scenario import Scenario, check_ranges, require
from scenarios.script import check_script
from topology.names import unknown_name


class Setup(msgspec.Struct, frozen=True):
    """Everything about a run but its randomness, which follows from the seed.

    Attributes:
        scenario: what was asked for, with nothing left open.
        neighbours: whom each node hears, ascending.
        weights: per node, its own weight first, then its neighbours'.
        initial_state, prior_mean (n,), prior_cov (n, n): where truth and filters begin.
        time_step_s: sampling time of the plant.
        losses: per node, the chance that a frame of each neighbour is lost, where links have their
            own; phases: whom each node hears in each of the graphs that take turns.
    """

    scenario: Scenario
    neighbours: list[list[int]]
    weights: list[list[float]]
    initial_state: list[float | None]
    prior_mean: list[float]
    prior_cov: list[list[float]]
    time_step_s: float
    losses: list[list[float]] | None = None
    phases: list[list[list[int]]] | None = None


def generator(scenario: Scenario, purpose: str, node: int) -> np.random.Generator:
    """The random stream of one purpose at one node in one run of a scenario."""
    return np.random.default_rng(stream_of(scenario, purpose, node))


def prepare(scenario: Scenario) -> Setup:
    """Check a scenario and work it out.

    Raises:
        ValueError: anything that cannot run, named with its value, the rule and the cure.
    """
    # Only here: a process of the network is handed the graph and need not know how to draw it.
    from topology.adjacency import neighbours_of
    from topology.analysis import require_connected
    from topology.graphs import build_network
    from topology.intel_lab import DATA_VARIABLE
    from topology.network import Network
    from topology.weights import build_weights, check_weights, per_node

    check_ranges(scenario)
    kind = kind_of(scenario.name)
    kind.check(scenario)
    plant = kind.plant(scenario)
    positions = plant.positions(0)
    radius = kind.radio_range_m if positions is not None else None
    data = scenario.data or os.environ.get(DATA_VARIABLE)

    def build(name: str) -> Network:
        return build_network(name, scenario.nodes, scenario.seed, positions, radius, data)

    network, phases = network_of(scenario, build)
    adjacency = network.adjacency
    require_connected(adjacency)
    weights = build_weights(scenario.weights, adjacency)
    check_weights(weights, adjacency)
    neighbours = neighbours_of(adjacency)
    rows = per_node(weights, neighbours)
    losses = losses_of(scenario, network, neighbours)
    turns = [neighbours_of(phase) for phase in phases] or None
    unborn = Setup(scenario, neighbours, rows, [], [], [], plant.time_step_s, losses, turns)
    setup = setup_of_run(unborn, scenario.run)
    check_network(setup)
    check_script(
        scenario, neighbours, partial(complete_settings, setup), partial(_equipment, setup)
    )
    return setup


def _equipment(setup: Setup, settings: Settings) -> Equipment:
    """What a network has that can be wrong, when these fields of its scenario are set."""
    changed = with_settings(setup, settings)
    plan = plan_bus(changed.scenario, share_bytes(changed), changed.neighbours)
    return equipment_of(changed, plan)


def setup_of_run(setup: Setup, run: int) -> Setup:
    """The same network in the run of that number: where truth and filters begin is drawn anew."""
    scenario = msgspec.structs.replace(setup.scenario, run=run)
    plant = kind_of(scenario.name).plant(scenario)
    draws = plant.draw(partial(generator, scenario), scenario.steps)
    initial_state, prior_mean, prior_cov = plant.initial(draws.initial)
    return msgspec.structs.replace(
        setup,
        scenario=scenario,
        initial_state=to_wire(initial_state),
        prior_mean=prior_mean.tolist(),
        prior_cov=prior_cov.tolist(),
    )


def check_network(setup: Setup) -> None:
    """Refuse values, a rule or a bus that this network cannot have.

    Raises:
        ValueError: naming the field, its value, the rule and the cure.
    """
    # Only here, as in `prepare`.
    from topology.weights import from_per_node

    scenario = setup.scenario
    check_ranges(scenario)
    kind = kind_of(scenario.name)
    kind.check(scenario)
    if kind.wiring is None:
        check_rule(scenario, setup.neighbours, from_per_node(setup.weights, setup.neighbours))
    plan = plan_bus(scenario, share_bytes(setup), setup.neighbours)
    check_bus(plan, scenario, setup.time_step_s)


def complete_settings(setup: Setup, settings: Settings) -> Settings:
    """Settings of a network that runs, with what they entail, checked.

    Raises:
        ValueError: naming the field, its value, the rule and the cure.
    """
    scenario = setup.scenario
    for name in settings:
        if name not in SETTINGS:
            raise unknown_name("setting", name, SETTINGS)
    if kind_of(scenario.name).wiring is not None:
        raise ValueError(f"set: {scenario.name} has one rule and schedule of its own; leave it out")
    # A part of the bus is a wish for a schedule that can give it.
    full = settings.get("schedule", scenario.schedule) == "full"
    if full and settings.get("occupancy", scenario.occupancy) != 1:
        settings = {**settings, "schedule": "hybrid"}
    try:
        changed = msgspec.convert({**msgspec.structs.asdict(scenario), **settings}, Scenario)
    except msgspec.ValidationError as error:
        raise ValueError(f"set: {error}") from None
    require(changed.rounds <= MAX_ROUNDS, "rounds", changed.rounds, f"at most {MAX_ROUNDS} here")
    check_network(msgspec.structs.replace(setup, scenario=changed))
    if is_certain(changed) != is_certain(scenario):
        raise ValueError(
            f"set rule={changed.rule}: {scenario.rule} keeps "
            f"{'sets' if is_certain(scenario) else 'covariances'}, which the other cannot take over"
        )
    return settings


def with_settings(setup: Setup, settings: Settings) -> Setup:
    """The setup of the same network and plant with other values for fields of its scenario."""
    scenario = msgspec.structs.replace(setup.scenario, **settings)
    return msgspec.structs.replace(setup, scenario=scenario)


def share_bytes(setup: Setup) -> int:
    """Length of the longest share in the network of this setup."""
    wiring = kind_of(setup.scenario.name).wiring
    if wiring is not None:
        return wiring.share_bytes(setup.scenario)
    return share_size(setup.scenario, len(setup.prior_mean))


def fingerprint(setup: Setup) -> str:
    """Digest of a setup, and of the version and the kernels that run it: equal where two processes
    agree to the last bit."""
    kernels = "numpy" if compiled.KERNELS is None else "compiled"
    data = msgspec.json.encode(setup) + f"{version('concord')} {kernels}".encode()
    return hashlib.sha256(data).hexdigest()
