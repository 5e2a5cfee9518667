"""From a setup to what the vectorised driver runs: many runs of it as one value."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import msgspec
import numpy as np

from bus import arbitration_lanes
from bus.arbitration import ArbiterState
from bus.arbitration_lanes import Order, serve
from bus.dynamic_segment import walk
from filters.gaussian import Gaussian
from filters.sigma_points import scaled_unscented
from nodes.bids import asked
from nodes.changes import UNCHANGED, Standing
from nodes.commands import Configure, Inject
from nodes.link_state import LinkState, hears_all
from nodes.messages import Bid
from nodes.node_changes import with_standing
from nodes.share import frame_payloads
from nodes.state_machine import contenders_left
from nodes.vectorised_changes import Turning, foreseen
from nodes.vectorised_filter import LocalFilters, SensorGroup
from nodes.vectorised_links import Links, Shares, links_of, places
from nodes.vectorised_network import Contest, Era, Network, Regime
from scenarios.build import build_controller, build_plan, everybody_of
from scenarios.bus_plan import BusPlan, arbitrate
from scenarios.catalogue import kind_of
from scenarios.fleets import FleetSeat
from scenarios.links import link_state
from scenarios.rules import hold_policy, rule_of, wire_number
from scenarios.scenario import Scenario
from scenarios.script import script_of
from scenarios.setup import Setup, complete_settings, share_bytes, with_settings
from scenarios.streams import streams_of

_ORDERS: dict[str, Order] = {
    "wtod": arbitration_lanes.wtod,
    "minislot": arbitration_lanes.minislot,
    "round-robin": arbitration_lanes.round_robin,
}


def without_array_form(scenario: Scenario) -> str | None:
    """What of a scenario has no array form and can only run message by message; None if all has."""
    kind = kind_of(scenario.name)
    if kind.wiring is not None:
        return f"scenario {scenario.name}"
    if kind.around is not None and scenario.adaptive:
        return "noise that nodes learn (--adaptive)"
    if any(isinstance(one.command, Inject) for one in script_of(scenario)):
        return "faults but kills, cuts and losses (--changes)"
    for held in (scenario, *_set_in(scenario)):
        rule = rule_of(held)
        if rule.fleet is None:
            return f"rule {held.rule}"
        if (lacking := rule.lacking(held)) is not None:
            return lacking
    return None


def _set_in(scenario: Scenario) -> Iterator[Scenario]:
    """The scenario each time that its changes have set something."""
    for _, command in script_of(scenario):
        if isinstance(command, Configure):
            scenario = msgspec.structs.replace(scenario, **command.settings)
            yield scenario


def turnings_of(setup: Setup) -> tuple[Turning, ...]:
    """What becomes of the network of a setup, from its first step on."""
    scenario = setup.scenario
    turnings = foreseen(
        script_of(scenario),
        setup.neighbours,
        scenario.steps,
        scenario.rounds,
        partial(complete_settings, setup),
    )
    if turnings and turnings[0].step == 0:
        return turnings
    return (Turning(0, UNCHANGED, (), False), *turnings)


def build_network(setup: Setup, runs: Sequence[int]) -> Network:
    """The runs of these numbers under the seed of a setup, with all their randomness drawn.

    Raises:
        ValueError: the scenario has no array form (`without_array_form`).
    """
    if (lacking := without_array_form(setup.scenario)) is not None:
        raise ValueError(f"{lacking} has no array form; use --driver in-process")
    scenarios = [msgspec.structs.replace(setup.scenario, run=run) for run in runs]
    scenario = setup.scenario
    kind = kind_of(scenario.name)
    plant = kind.plant(scenario)
    stream = streams_of(scenario, runs)
    draws = [plant.draw(partial(stream, which), scenario.steps) for which in range(len(runs))]
    states, means, covs = zip(*(plant.initial(one.initial) for one in draws), strict=True)
    n, nodes = len(setup.prior_mean), scenario.nodes
    prior = Gaussian(
        np.repeat(np.stack(means)[:, None], nodes, axis=1),
        np.broadcast_to(covs[0], (len(runs), nodes, n, n)),
    )
    # Who comes back has forgotten what others still hold of the same node: links differ then.
    links = links_of(setup.neighbours, link_state(setup).perfect and not scenario.changes)
    return Network(
        plant=plant,
        initial_state=np.stack(states),
        prior=prior,
        process=np.stack([one.process for one in draws], axis=1),
        measurement=np.stack([one.measurement for one in draws], axis=1),
        steps=scenario.steps,
        controller=build_controller(scenario),
        delivery=kind.delivery(scenario) if kind.delivery else None,
        receivers=links.receiver,
        eras=tuple(_eras(setup, scenarios, links)),
    )


def _eras(setup: Setup, scenarios: Sequence[Scenario], links: Links) -> Iterator[Era]:
    """What holds when, in runs of these scenarios."""
    scenario = setup.scenario
    states = [link_state(msgspec.structs.replace(setup, scenario=one)) for one in scenarios]
    changed, plan, regime = setup, build_plan(setup), None
    for step, standing, joined, anew in turnings_of(setup):
        if regime is None or anew:
            changed = with_settings(setup, standing.settings)
            plan = build_plan(changed)
            regime = _regime(changed, plan, links, standing, len(scenarios))
        present = np.ones(scenario.nodes, dtype=bool)
        present[list(standing.absent)] = False
        standing_states = [with_standing(state, standing) for state in states]
        lost = None
        if not standing_states[0].perfect:
            lost = partial(_lost, standing_states, links, partial(frames_of, changed, plan))
        yield Era(step, regime, present, joined, lost)


def _regime(setup: Setup, plan: BusPlan, links: Links, standing: Standing, runs: int) -> Regime:
    """Rule and bus of a setup whose settings are those that stand."""
    rule = rule_of(setup.scenario)
    assert rule.fleet is not None, "without_array_form has looked"
    contest, memory = _contest(setup, plan, runs)
    return Regime(
        standing.first_step,
        standing.first_cycle,
        setup.scenario.rounds,
        plan.schedule,
        contest,
        memory,
        partial(framed, setup, plan),
        rule.fleet(_seat(setup, plan, links)),
    )


def _seat(setup: Setup, plan: BusPlan, links: Links) -> FleetSeat:
    scenario = setup.scenario
    kind = kind_of(scenario.name)
    own = np.array([row[0] for row in setup.weights])
    link = np.array([weight for row in setup.weights for weight in row[1:]])
    points = kind.points(scenario) if kind.points else scaled_unscented(len(setup.prior_mean))
    contenders = {node for row in plan.schedule.contender_table for node in row}
    return FleetSeat(
        LocalFilters(kind.model(scenario), sensor_groups(scenario), points),
        links,
        Shares(own[None], link[None]),
        hold_policy(scenario),
        scenario.rounds,
        np.array(sorted(contenders), dtype=np.int64),
        scenario.trigger,
        wire_number(scenario),
        setup.neighbours,
        partial(everybody_of, setup, plan.schedule),
    )


def sensor_groups(scenario: Scenario) -> tuple[SensorGroup, ...]:
    """The sensors of all nodes: one for all where the scenario has such, else one for each."""
    kind = kind_of(scenario.name)
    if kind.sensors is not None:
        return (SensorGroup(slice(None), kind.sensors(scenario)),)
    single = ((node, kind.sensor(scenario, node)) for node in range(scenario.nodes))
    return tuple(SensorGroup(slice(i, i + 1), one) for i, one in single if one is not None)


# --- the bus -------------------------------------------------------------------------------------


def frames_of(setup: Setup, plan: BusPlan, cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """How many frames a share of each node takes in a cycle, and the payload in bytes of all of
    them together, (N,) each; 0 for nodes that have no slot. For rules whose shares have one length.
    """
    frames, payload = np.zeros((2, plan.schedule.nodes), dtype=np.int64)
    static = plan.schedule.static_senders(cycle)
    for nodes in (static, contenders_left(plan.schedule, cycle, ())):
        if nodes:
            # All static slots of a cluster are alike, and so are the dynamic ones of all nodes.
            lengths = frame_payloads(share_bytes(setup), plan.slots(nodes[0], cycle))
            owners = places(nodes)
            frames[owners], payload[owners] = len(lengths), sum(lengths)
    return frames, payload


def framed(
    setup: Setup, plan: BusPlan, cycle: int, sends: np.ndarray, body_bytes: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Number of frames and bytes of payload (R, N) of those that send (R, N) in a cycle, shares of
    `body_bytes` (R, N); None where all have one length."""
    if body_bytes is None:
        frames, payload = frames_of(setup, plan, cycle)
        return np.where(sends, frames, 0), np.where(sends, payload, 0)
    frames = np.zeros(sends.shape, dtype=np.int64)
    payload = np.zeros_like(frames)
    for node in np.flatnonzero(sends.any(axis=0)).tolist():
        slots = plan.slots(node, cycle)
        lengths, which = np.unique(body_bytes[:, node], return_inverse=True)
        made = [frame_payloads(length, slots) for length in lengths.tolist()]
        frames[:, node] = np.array([len(sizes) for sizes in made])[which]
        payload[:, node] = np.array([sum(sizes) for sizes in made])[which]
    return np.where(sends, frames, 0), np.where(sends, payload, 0)


def _lost(
    states: list[LinkState],
    links: Links,
    frames_in: Callable[[int], tuple[np.ndarray, np.ndarray]],
    step: int,
    cycle: int,
) -> np.ndarray:
    """How many frames of a share each link loses in a cycle, (R, E)."""
    of_sender = frames_in(cycle)[0][links.sender]
    lost = np.zeros((len(states), len(links.sender)), dtype=np.int64)
    part = (np.array(step), np.array(cycle), links.sender, links.receiver)
    for number in range(int(of_sender.max(initial=0))):
        for run, state in enumerate(states):
            arrives = hears_all(state, *part, number)
            lost[run] += ~arrives & (number < of_sender)
    return lost


def _contest(setup: Setup, plan: BusPlan, runs: int) -> tuple[Contest, Any]:
    """The arbiter of all runs and what it remembers: in arrays where whoever wins fits."""
    if _whoever_wins_fits(plan):
        return partial(_serve, _ORDERS[setup.scenario.arbiter], plan), np.zeros(
            runs, dtype=np.int64
        )
    return partial(_serve_one_by_one, setup, plan), (ArbiterState(),) * runs


def _whoever_wins_fits(plan: BusPlan) -> bool:
    slots = max(plan.schedule.dynamic_slot_table)
    contenders = sorted({node for row in plan.schedule.contender_table for node in row})
    if not (slots and contenders):
        return True
    assert plan.cluster is not None and plan.table is not None, "a dynamic segment has a cluster"
    # The last IDs are the worst: every slot before them counts by empty.
    requests = [plan.table.request(node, 0) for node in contenders[-slots:]]
    return not walk(plan.cluster, requests).waiting


def _serve(
    order: Order,
    plan: BusPlan,
    last: np.ndarray,
    cycle: int,
    group: int,
    nodes: np.ndarray,
    bids: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    frame_ids = np.array([plan.slots(int(node), cycle)[0].frame_id for node in nodes])
    ascending = np.argsort(frame_ids)
    last, ordered = serve(
        order,
        last,
        frame_ids[ascending],
        bids[:, ascending],
        bids[:, ascending] >= 0,
        plan.schedule.groups(cycle)[group].dynamic_slots,
    )
    wins = np.empty_like(ordered)
    wins[:, ascending] = ordered
    return last, wins


def _serve_one_by_one(
    setup: Setup,
    plan: BusPlan,
    states: tuple[ArbiterState, ...],
    cycle: int,
    group: int,
    nodes: np.ndarray,
    bids: np.ndarray,
) -> tuple[tuple[ArbiterState, ...], np.ndarray]:
    """What fits beside what hangs on frame IDs: each run has the arbiter of the world."""
    decide = arbitrate(setup.scenario, plan)
    payload = frames_of(setup, plan, cycle)[1].tolist()
    wins = np.zeros(bids.shape, dtype=bool)
    after = []
    for run, state in enumerate(states):
        requests = tuple(
            Bid(node, cycle, asked(bid), payload[node], group)
            for node, bid in zip(nodes.tolist(), bids[run], strict=True)
        )
        state, winners = decide(state, cycle, requests)
        wins[run] = np.isin(nodes, winners)
        after.append(state)
    return tuple(after), wins
