"""From a setup to what the batched driver runs: many runs of it as one value."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import msgspec
import numpy as np

from concord.bus.arbitration import ArbiterState, begin_arbitration
from concord.bus.bus import Awards, Bus
from concord.filters.gaussian import Gaussian
from concord.nodes.changes import UNCHANGED, Standing
from concord.nodes.commands import Configure, Inject, Kill
from concord.nodes.faults.losses import LinkState, hears_all
from concord.nodes.lanes.links import Links, Shares, links_of, places
from concord.nodes.lanes.network import BatchedNetwork, RunSegment, RunSettings
from concord.nodes.node import contenders_left
from concord.nodes.node_changes import with_standing
from concord.nodes.rules.local_filter import LocalFilters
from concord.runtime.batched.changes import ScriptedChange, foreseen
from concord.runtime.batched.streams import streams_of
from concord.scenarios.build import (
    build_bus,
    build_controller,
    everybody_of,
    filter_of,
    rule_context,
)
from concord.scenarios.catalogue import definition_of
from concord.scenarios.equipment import build_faults
from concord.scenarios.links import link_state
from concord.scenarios.node_context import BatchContext, Beginning
from concord.scenarios.preparation import (
    complete_settings,
    prepare,
    scripted_settings,
    share_bytes,
    with_settings,
)
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import withdraws


def without_array_form(scenario: Scenario) -> str | None:
    """Return the part of a scenario that can only run message by message; None if none."""
    definition = definition_of(scenario)
    if any(isinstance(one.command, Inject) for one in script_of(scenario)):
        return "faults but kills, cuts and losses (--changes)"
    later = tuple(_set_in(scenario))
    if any(held.network.graph != scenario.network.graph for held in later):
        return "another graph (--changes)"
    if any(held.plant != scenario.plant for held in later):
        return "sensors at other places (--changes)"
    if _loses_clocks(scenario):
        return "kills that leave clocks without sync frames (--changes)"
    if not withdraws(scenario.bus):
        return "a share that is cut (--no-withdrawal)"
    if (wiring := definition.wiring(scenario)) is not None:
        return wiring.lacking(scenario)
    for held in (scenario, *later):
        rule = rule_of(held)
        if (lacking := rule.lacking(held)) is not None:
            return lacking
    return None


def _loses_clocks(scenario: Scenario) -> bool:
    """Return whether a script ever takes so many sync frames that the clocks of others suffer."""
    if not any(isinstance(one.command, Kill) for one in script_of(scenario)):
        return False
    setup = prepare(scenario)
    for change in changes_of(setup):
        changed = with_settings(setup, change.standing.settings)
        if build_faults(changed, build_bus(changed)).stand(change.standing).outages:
            return True
    return False


def _set_in(scenario: Scenario) -> Iterator[Scenario]:
    """Yield the scenario each time that its changes have set something."""
    if any(isinstance(one.command, Configure) for one in script_of(scenario)):
        for _, settings in scripted_settings(prepare(scenario)):
            yield scenario.with_known(**settings)[0]


def changes_of(setup: Setup) -> tuple[ScriptedChange, ...]:
    """Return the changes to the network of a setup, from its first step on."""
    scenario = setup.scenario
    changes = foreseen(
        script_of(scenario),
        setup.neighbours,
        scenario.steps,
        scenario.rounds,
        partial(complete_settings, setup),
    )
    if changes and changes[0].step == 0:
        return changes
    return (ScriptedChange(0, UNCHANGED, (), False), *changes)


def build_network(
    setup: Setup, runs: Sequence[int], bus_of: Callable[[Setup], Bus] = build_bus
) -> BatchedNetwork:
    """The runs of these numbers under the seed of a setup, with all their randomness drawn.

    `bus_of` makes the bus of a setup; by default that of the scenario.

    Raises:
        ValueError: the scenario has no array form (`without_array_form`).
    """
    if (lacking := without_array_form(setup.scenario)) is not None:
        raise ValueError(f"{lacking} has no array form; use --driver in-process")
    scenarios = [msgspec.structs.replace(setup.scenario, run=run) for run in runs]
    scenario = setup.scenario
    definition = definition_of(scenario)
    plant = definition.plant(scenario)
    stream = streams_of(scenario, runs)
    draws = [plant.draw(partial(stream, which), scenario.steps) for which in range(len(runs))]
    states, means, covs = zip(*(plant.initial(one.initial) for one in draws), strict=True)
    n, nodes = len(setup.prior_mean), scenario.nodes
    prior = Gaussian(
        np.repeat(np.stack(means)[:, None], nodes, axis=1),
        np.broadcast_to(covs[0], (len(runs), nodes, n, n)),
    )
    # A returned node has forgotten shares that others still hold, so links to one node differ.
    links = links_of(setup.neighbours, link_state(setup).perfect and not scenario.changes)
    return BatchedNetwork(
        plant=plant,
        initial_state=np.stack(states),
        prior=prior,
        process=np.stack([one.process for one in draws], axis=1),
        measurement=np.stack([one.measurement for one in draws], axis=1),
        steps=scenario.steps,
        controller=build_controller(scenario),
        delivery=definition.delivery(scenario) if definition.delivery else None,
        receivers=links.receiver,
        segments=tuple(_segments(setup, scenarios, links, bus_of)),
    )


def _segments(
    setup: Setup, scenarios: Sequence[Scenario], links: Links, bus_of: Callable[[Setup], Bus]
) -> Iterator[RunSegment]:
    """Yield the segments of runs of these scenarios."""
    scenario = setup.scenario
    states = [link_state(msgspec.structs.replace(setup, scenario=one)) for one in scenarios]
    changed, bus, settings = setup, bus_of(setup), None
    for step, standing, joined, anew in changes_of(setup):
        if settings is None or anew:
            changed = with_settings(setup, standing.settings)
            bus = bus_of(changed)
            settings = _settings(changed, bus, links, standing, len(scenarios))
        present = np.ones(scenario.nodes, dtype=bool)
        present[list(standing.absent)] = False
        standing_states = [with_standing(state, standing) for state in states]
        lost = None
        if not standing_states[0].perfect:
            lost = partial(lost_frames, standing_states, links, partial(frames_of, changed, bus))
        yield RunSegment(step, settings, present, joined, lost)


def _settings(setup: Setup, bus: Bus, links: Links, standing: Standing, runs: int) -> RunSettings:
    """Rule and bus of a setup whose settings are those that stand."""
    wiring = definition_of(setup.scenario).wiring(setup.scenario)
    if wiring is None:
        rule = rule_of(setup.scenario).batched(batch_context(setup, bus, links, standing))
    else:
        assert wiring.batched is not None, "without_array_form has refused it"
        rule = wiring.batched(setup, bus, links)
    return RunSettings(
        standing.first_step,
        standing.first_cycle,
        setup.scenario.rounds,
        bus.schedule,
        partial(_contest, setup, bus),
        begin_arbitration(setup.scenario.nodes, (runs,)),
        partial(framed, setup, bus),
        rule,
    )


def batch_context(
    setup: Setup, bus: Bus, links: Links, standing: Standing = UNCHANGED
) -> BatchContext:
    """Return the input of a setup's rule at all nodes of many runs."""
    scenario = setup.scenario
    definition = definition_of(scenario)
    own = np.array([row[0] for row in setup.weights])
    link = np.array([weight for row in setup.weights for weight in row[1:]])
    filters = LocalFilters(
        definition.model(scenario), definition.sensor_groups(scenario), filter_of(setup)
    )
    contenders = {node for row in bus.schedule.contender_table for node in row}
    return BatchContext(
        rule_context(setup, bool(contenders)),
        filters,
        links,
        Shares(own[None], link[None]),
        scenario.rounds,
        np.array(sorted(contenders), dtype=np.int64),
        partial(everybody_of, setup, bus.schedule),
        Beginning(standing.first_step, standing.first_cycle),
    )


# --- the bus -------------------------------------------------------------------------------------


def frames_of(setup: Setup, bus: Bus, cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """How many frames a share of each node takes in a cycle, and the payload in bytes of all of
    them together, (N,) each; 0 for nodes that have no slot. For rules whose shares have one length.
    """
    frames, payload = np.zeros((2, bus.schedule.nodes), dtype=np.int64)
    static = bus.schedule.static_senders(cycle)
    for nodes in (static, contenders_left(bus.schedule, cycle, ())):
        if nodes:
            # All static slots of a cluster are alike, and so are the dynamic ones of all nodes.
            lengths = bus.payloads(nodes[0], cycle, share_bytes(setup))
            owners = places(nodes)
            frames[owners], payload[owners] = len(lengths), sum(lengths)
    return frames, payload


def framed(
    setup: Setup, bus: Bus, cycle: int, sends: np.ndarray, body_bytes: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Number of frames and bytes of payload (R, N) of those that send (R, N) in a cycle, shares of
    `body_bytes` (R, N); None where all have one length."""
    if body_bytes is None:
        frames, payload = frames_of(setup, bus, cycle)
        return np.where(sends, frames, 0), np.where(sends, payload, 0)
    frames = np.zeros(sends.shape, dtype=np.int64)
    payload = np.zeros_like(frames)
    for node in np.flatnonzero(sends.any(axis=0)).tolist():
        lengths, which = np.unique(body_bytes[:, node], return_inverse=True)
        made = [bus.payloads(node, cycle, length) for length in lengths.tolist()]
        frames[:, node] = np.array([len(sizes) for sizes in made])[which]
        payload[:, node] = np.array([sum(sizes) for sizes in made])[which]
    return np.where(sends, frames, 0), np.where(sends, payload, 0)


def lost_frames(
    states: list[LinkState],
    links: Links,
    frames_in: Callable[[int], tuple[np.ndarray, np.ndarray]],
    step: int,
    cycle: int,
) -> np.ndarray:
    """How many frames of a share each link loses in a cycle, (R, E)."""
    of_sender = frames_in(cycle)[0][links.sender]
    lost = np.zeros((len(states), len(links.sender)), dtype=np.int64)
    instant = (np.array(step), np.array(cycle), links.sender, links.receiver)
    for number in range(int(of_sender.max(initial=0))):
        for run, state in enumerate(states):
            arrives = hears_all(state, *instant, number)
            lost[run] += ~arrives & (number < of_sender)
    return lost


def _contest(
    setup: Setup,
    bus: Bus,
    state: ArbiterState,
    cycle: int,
    group: int,
    nodes: np.ndarray,
    bids: np.ndarray,
    body_bytes: Callable[[], np.ndarray | None],
) -> Awards:
    """The arbiter of all runs."""

    def payload() -> np.ndarray:
        bodies = body_bytes()
        if bodies is None:
            return np.broadcast_to(frames_of(setup, bus, cycle)[1][nodes], bids.shape)
        lengths, which = np.unique(bodies, return_inverse=True)
        # The dynamic slots of all nodes are alike.
        sums = [sum(bus.payloads(int(nodes[0]), cycle, length)) for length in lengths.tolist()]
        return np.array(sums, dtype=np.int64)[which].reshape(bids.shape)

    return bus.arbitrate(state, cycle, group, nodes, bids, payload)
