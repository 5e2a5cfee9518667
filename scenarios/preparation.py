"""Work a scenario out: check it, draw its network, and change the settings of one that runs."""

import hashlib
import re
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from concord._version import __version__
from concord.bus.bus import Bus, TooLong
from concord.filters.gaussian import Gaussian
from concord.nodes.bounds import MAX_ROUNDS
from concord.nodes.changes import Settings
from concord.nodes.commands import Configure
from concord.nodes.faults.active import Equipment
from concord.nodes.messages import from_wire, to_wire
from concord.nodes.share_forms import MEAN_REACH
from concord.plants.placement import FILE, is_move, moved_sites, site_text
from concord.scenarios.bus_table.bus_plan import build_schedule, plan_bus, with_pinned_arbiter
from concord.scenarios.catalogue import definition_of
from concord.scenarios.equipment import equipment_of
from concord.scenarios.filter_table.filters import check_models, check_prior
from concord.scenarios.links import losses_of, network_of, require_static_links
from concord.scenarios.rule_table.rules import (
    check_rule,
    is_set_valued,
    share_size,
    try_own_rule,
)
from concord.scenarios.scenario import SETTINGS, Scenario, require
from concord.scenarios.scenario_definition import ScenarioPlant
from concord.scenarios.script import check_script, script_of
from concord.scenarios.setup import Setup, generator
from concord.scenarios.types.assignment import check_ranges, refuse_left
from concord.scenarios.types.buses import UserBus, stretch_of
from concord.scenarios.types.plants import PlacedSensors
from concord.scenarios.types.rules import number_of
from concord.scenarios.user.bus import check_user_bus
from concord.scenarios.user.values import is_source_name, source_of, value_of
from concord.topology.names import is_file_name, unknown_name

# In JSON a colon without a quotation mark before it is part of a word, such as FILE.py:NAME.
_NAMES_FILES = re.compile(rb'[^"]:|"data":"')


def prepare(scenario: Scenario, *, tries_rule: bool = True) -> Setup:
    """Check a scenario and work it out; a rule of the user's own is tried, if `tries_rule`.

    Raises:
        ValueError: anything that cannot run, named with its value, the rule and the cure.
    """
    check_ranges(scenario)
    scenario = with_pinned_arbiter(scenario)
    definition = definition_of(scenario)
    definition.refuse(scenario)
    if _NAMES_FILES.search(msgspec.json.encode(scenario)):
        # Only here: most scenarios name no file.
        from concord.scenarios.user.trust import remember

        remember(scenario)
    plant = definition.plant(scenario)
    neighbours, weights, losses, phases = _graph(scenario, plant)
    unborn = Setup(scenario, neighbours, weights, [], [], [], plant.time_step_s, losses, phases)
    setup = setup_of_run(unborn, scenario.run)
    check_network(setup)
    _check_filter(setup)
    # Only here: a process of the network rehearses nothing.
    from concord.scenarios.rehearsal import check_readings

    check_readings(setup)
    if tries_rule:
        _try_rule(setup)
    check_script(
        scenario,
        lambda settings: with_settings(setup, settings).neighbours,
        partial(complete_settings, setup),
        partial(_equipment, setup),
    )
    return setup


class _Graph(NamedTuple):
    """The graph of a `Setup`, with all that comes with it."""

    neighbours: list[list[int]]
    weights: list[list[float]]
    losses: list[list[float]] | None
    phases: list[list[list[int]]] | None


def _graph(scenario: Scenario, plant: ScenarioPlant) -> _Graph:
    """Draw the graph of a scenario, with its weights.

    Raises:
        ValueError: a graph that is none, that is not connected, or that cannot have these weights.
    """
    # Only here: a process of the network is handed the graph of the beginning, and draws another
    # one only where a change asks for it.
    from concord.topology.adjacency import neighbours_of
    from concord.topology.analysis import require_connected
    from concord.topology.edge_text import edge_text
    from concord.topology.graphs import build_network
    from concord.topology.network import Network
    from concord.topology.weights import build_weights, check_weights, per_node

    positions = plant.positions(0)
    radius = definition_of(scenario).radio_range_m if positions is not None else None

    def build(name: str) -> Network:
        if is_source_name(name):
            name = edge_text(value_of(source_of(name)))
        return build_network(name, scenario.nodes, scenario.seed, positions, radius)

    network, phases = network_of(scenario, build)
    require_connected(network.adjacency)
    weights = build_weights(scenario.network.weights, network.adjacency)
    check_weights(weights, network.adjacency)
    neighbours = neighbours_of(network.adjacency)
    return _Graph(
        neighbours,
        per_node(weights, neighbours),
        losses_of(scenario, network, neighbours),
        [neighbours_of(phase) for phase in phases] or None,
    )


def _equipment(setup: Setup, settings: Settings) -> Equipment:
    """Return the network's equipment when these fields of its scenario are set."""
    changed = with_settings(setup, settings)
    return equipment_of(changed, _planned_bus(changed))


def setup_of_run(setup: Setup, run: int) -> Setup:
    """The same network in the run of that number: where truth and filters begin is drawn anew."""
    scenario = msgspec.structs.replace(setup.scenario, run=run)
    definition = definition_of(scenario)
    if definition.is_received and run == setup.scenario.run:
        return setup
    plant = definition.plant(scenario)
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
    from concord.topology.weights import from_per_node

    scenario = setup.scenario
    check_ranges(scenario)
    definition = definition_of(scenario)
    definition.refuse(scenario)
    wiring = definition.wiring(scenario)
    if wiring is None:
        check_rule(scenario, setup.neighbours, from_per_node(setup.weights, setup.neighbours))
        _check_reach(setup)
    else:
        wiring.check(setup)
    bus = _planned_bus(setup)
    if isinstance(scenario.bus, UserBus):
        schedule = build_schedule(scenario, setup.neighbours)
        check_user_bus(scenario.bus, bus, schedule, share_bytes(setup))
    bus.check_pace(scenario.rounds, setup.time_step_s, stretch_of(scenario.bus))


def _planned_bus(setup: Setup) -> Bus:
    """Return the bus of a setup.

    Raises:
        ValueError: it does not hold the shares, or cannot be; naming what would fit.
    """
    scenario, size = setup.scenario, share_bytes(setup)
    try:
        return plan_bus(scenario, size, setup.neighbours)
    except TooLong as error:
        if definition_of(scenario).wiring(scenario) is not None:
            raise
        # Only here: a network whose shares fit needs nothing of it.
        from concord.scenarios.bus_table.what_fits import what_fits

        raise ValueError(f"{error}; {what_fits(setup)}") from None


def _check_reach(setup: Setup) -> None:
    """Refuse two bytes a number where the mean of the beginning is too far from zero for them.

    Raises:
        ValueError: naming the state, its mean, and the cure.
    """
    if number_of(setup.scenario.rule) != "float16":
        return
    origin = definition_of(setup.scenario).origin(setup.scenario)
    means = np.array(setup.prior_mean) - (0.0 if origin is None else origin)
    deviations = np.sqrt(np.diagonal(setup.prior_cov))
    for state, (mean, deviation) in enumerate(zip(means, deviations, strict=True)):
        if abs(mean) > MEAN_REACH * deviation:
            raise ValueError(
                f"--number float16: state {state} begins at {mean:g} with a standard deviation of "
                f"{deviation:g}, and two bytes reach {int(MEAN_REACH)} deviations from zero; use "
                "--number float32, or coordinates with their origin nearer to the plant"
            )


def _check_filter(setup: Setup) -> None:
    """Refuse a filter that cannot compute with the plant and the sensors.

    Raises:
        ValueError: naming the filter, what is in its way, and the cure.
    """
    scenario = setup.scenario
    definition = definition_of(scenario)
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    if definition.wirings:
        check_prior(scenario.filter, prior)
        return
    plant = definition.plant(scenario)
    noise = plant.draw(partial(generator, scenario), 1).measurement[0]
    check_models(
        scenario.filter,
        prior,
        definition.model(scenario),
        definition.sensor_groups(scenario),
        plant.observe(from_wire(setup.initial_state), noise, 0),
    )


def _try_rule(setup: Setup) -> None:
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    try_own_rule(setup.scenario, prior, setup.neighbours)


def complete_settings(setup: Setup, before: Settings, asked: Settings) -> Settings:
    """Return all settings of a network that runs, of which some were set before.

    A setting from before is dropped where what is asked chooses a value without that option. The
    schedule is among the settings where an occupancy chooses it.

    Raises:
        ValueError: naming the option, its value, the rule and the cure.
    """
    scenario = setup.scenario
    for name in asked:
        if name not in SETTINGS:
            raise unknown_name("setting", name, SETTINGS)
    if definition_of(scenario).wirings:
        raise ValueError(f"set: {scenario.name} has one rule and schedule of its own; leave it out")
    settings, there = {**before, **asked}, with_settings(setup, before).scenario
    if "placement" in asked and isinstance(there.plant, PlacedSensors):
        settings["placement"] = _sites(there, asked["placement"])
        there = there.with_(placement=settings["placement"])
    if "graph" in asked:
        settings["graph"] = _edges(there, str(asked["graph"]))
    changed, left = scenario.with_known(**settings)
    refuse_left(changed, {name: value for name, value in left.items() if name in asked})
    require(changed.rounds <= MAX_ROUNDS, "rounds", changed.rounds, f"at most {MAX_ROUNDS} here")
    settled = with_settings(setup, settings)
    check_network(settled)
    if "rule" in asked:
        _try_rule(settled)
    if is_set_valued(changed) != is_set_valued(scenario):
        raise ValueError(
            f"set rule={changed.rule.name}: {scenario.rule.name} keeps "
            f"{'sets' if is_set_valued(scenario) else 'covariances'}, "
            "which the other cannot take over"
        )
    if changed.bus.schedule.name != scenario.bus.schedule.name:
        settings = {**settings, "schedule": changed.bus.schedule.name}
    return {name: value for name, value in settings.items() if name not in left}


def scripted_settings(setup: Setup) -> Iterator[tuple[int, Settings]]:
    """Yield each step in which the script sets something, and all settings from then on."""
    settings: Settings = {}
    for step, command in script_of(setup.scenario):
        if isinstance(command, Configure):
            settings = complete_settings(setup, settings, command.settings)
            yield step, settings


def _edges(scenario: Scenario, graph: str) -> str:
    """Return a graph for a network that runs as the word for its edges, which no process can take
    for another one.

    Raises:
        ValueError: a graph that is none, or links that follow graphs of their own.
    """
    # Only here, as in `_graph`.
    from concord.topology.edge_text import edge_text

    require_static_links(scenario, f"set graph={graph}")
    if is_source_name(graph) or is_file_name(graph):
        raise ValueError(
            f"set graph={graph}: a network that runs reads no files; name a graph such as ring, or "
            "write edges:0-1;1-2"
        )
    asked = scenario.with_(graph=graph)
    hears = np.zeros((asked.nodes, asked.nodes))
    for node, heard in enumerate(_graph(asked, definition_of(asked).plant(asked)).neighbours):
        hears[node, heard] = 1
    return edge_text(hears)


def _sites(scenario: Scenario, asked: int | float | str) -> str:
    """Return the sites of all sensors as one word, from the number of a drawing, from sites, or
    from moves (`3@120/450;5@0/9`) of sensors that stand where `scenario` says.

    Raises:
        ValueError: sites that are none, or links that follow graphs of their own.
    """
    require_static_links(scenario, f"set placement={asked}")
    if isinstance(asked, str) and asked.startswith(FILE):
        raise ValueError(
            f"set placement={asked}: a network that runs reads no files; write NODE@x/y in m for "
            "each sensor that moves"
        )
    moves = isinstance(asked, str) and is_move(asked)
    there = scenario if moves else scenario.with_known(placement=asked)[0]
    places = definition_of(there).plant(there).positions(0)
    assert places is not None, "the plant has a placement"
    return site_text(moved_sites(str(asked), places) if moves else places)


def with_settings(setup: Setup, settings: Settings) -> Setup:
    """The setup of the same network and plant with other values for options of its scenario."""
    scenario, _ = setup.scenario.with_known(**settings)
    changed = msgspec.structs.replace(setup, scenario=scenario)
    stays = scenario.network.graph == setup.scenario.network.graph
    moves = scenario.plant != setup.scenario.plant and scenario.network.graph == "geometric"
    if stays and not moves:
        return changed
    drawn = _graph(scenario, definition_of(scenario).plant(scenario))
    return msgspec.structs.replace(changed, **drawn._asdict())


def share_bytes(setup: Setup) -> int:
    """Length of the longest share in the network of this setup."""
    wiring = definition_of(setup.scenario).wiring(setup.scenario)
    if wiring is not None:
        return wiring.share_bytes(setup.scenario)
    return share_size(setup.scenario, len(setup.prior_mean))


def fingerprint(setup: Setup) -> str:
    """Digest of a setup and of the version that runs it.

    Two processes with one digest compute equal bits.
    """
    data = msgspec.json.encode(setup) + __version__.encode()
    return hashlib.sha256(data).hexdigest()
