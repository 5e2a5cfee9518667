"""The bus of a scenario: its schedule, and what carries the longest share."""

from collections.abc import Callable, Sequence

import msgspec

from concord.bus.arbitration import ARBITERS, ONE_CLASS, Arbiter, Urgency, UrgencyClasses
from concord.bus.bus import Bus
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.schedule import (
    Schedule,
    dynamic_only,
    full_publish,
    hybrid,
    publishers_per_cycle,
    round_robin,
)
from concord.entries import chosen, entries
from concord.nodes.rules.lane_rule import BIDS_FOR_CHANGE
from concord.scenarios.bus_table.bus_definition import BusRequest, bus_definition
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import FlexRay, SharedBus, UserBus
from concord.scenarios.types.rules import FloodingRule, latch_delay_of
from concord.scenarios.types.schedules import (
    WrittenSchedule,
    arbiter_of,
    occupancy_of,
    urgency_classes_of,
)
from concord.scenarios.user.bus import user_bus
from concord.scenarios.user.values import function_or, is_source_name, pinned, source_of
from concord.topology.names import unknown_name


def with_pinned_arbiter(scenario: Scenario) -> Scenario:
    """The scenario with the digest of its arbiter's file beside its name, if it has such a file.

    Raises:
        ValueError: there is no such file.
    """
    name = arbiter_of(scenario.bus.schedule)
    return scenario.with_(arbiter=pinned(name)) if is_source_name(name) else scenario


def arbiter_named(name: str) -> Arbiter:
    """The arbiter of a name, or of a user's file: an `Arbiter`, or its function of urgency."""
    if not is_source_name(name):
        if name not in arbiter_names():
            raise unknown_name("arbiter", name, arbiter_names())
        return ARBITERS[name] if name in ARBITERS else _as_arbiter(chosen("ARBITERS", name))
    must = "a function urgency(state, bids, frame_ids), or an Arbiter of concord.bus.arbitration"
    return _as_arbiter(function_or(Arbiter, source_of(name), must))


def _as_arbiter(value: Arbiter | Urgency) -> Arbiter:
    return value if isinstance(value, Arbiter) else Arbiter(value)


# Nodes that pass records on ask in most cycles. If each were old after a turn of all, slots would
# go by age and not by need. Two classes leave one for all needs: there only age tells nodes apart.
# Scans, which are the records of a wiring, come sooner with an age of one turn (docs/targets.md).
_TURNS_BEFORE_OLD, _LEAST_CLASSES_BY_NEED = 12, 3

Neighbours = Sequence[Sequence[int]]


def _leaves_first(nodes: int, neighbours: Neighbours) -> list[int]:
    """Nodes by how many they hear; by number where the graph is unknown."""
    degrees = [len(heard) for heard in neighbours] or [0] * nodes
    return sorted(range(nodes), key=lambda node: (degrees[node], node))


_SCHEDULES: dict[str, Callable[[int, float, Neighbours], Schedule]] = {
    "full": lambda nodes, _occupancy, _neighbours: full_publish(nodes),
    "round-robin": lambda nodes, occupancy, _neighbours: round_robin(
        nodes, publishers_per_cycle(nodes, occupancy)
    ),
    "hybrid": lambda nodes, occupancy, _neighbours: hybrid(nodes, occupancy),
    "hybrid-leaves": lambda nodes, occupancy, neighbours: hybrid(
        nodes, occupancy, _leaves_first(nodes, neighbours)
    ),
    "dynamic": lambda nodes, occupancy, _neighbours: dynamic_only(nodes, occupancy),
}


def schedule_names() -> tuple[str, ...]:
    """The schedules there are."""
    return tuple(_SCHEDULES)


def arbiter_names() -> tuple[str, ...]:
    """The arbiters of the dynamic segment: those of the core, and those that entries bring."""
    return (*ARBITERS, *entries("ARBITERS"))


def build_schedule(scenario: Scenario, neighbours: Neighbours = ()) -> Schedule:
    """Return the schedule of a scenario, on a graph that says which nodes each node hears.

    Raises:
        ValueError: there is no such schedule or arbiter here.
    """
    wiring = definition_of(scenario).wiring(scenario)
    if wiring is not None and wiring.schedule is not None:
        return wiring.schedule(scenario)
    chosen = scenario.bus.schedule
    if isinstance(chosen, WrittenSchedule):
        assert isinstance(scenario.bus, FlexRay)
        # Only here: most networks have no written table.
        from concord.scenarios.bus_table.written_plan import schedule_of_table

        return _relayed(scenario, schedule_of_table(scenario.bus, chosen, scenario.nodes))
    if chosen.name not in _SCHEDULES:
        raise unknown_name("schedule", chosen.name, _SCHEDULES)
    arbiter_named(arbiter_of(chosen))
    senders = senders_of(scenario, neighbours)
    heard = [neighbours[node] for node in senders] if neighbours else ()
    schedule = _SCHEDULES[chosen.name](len(senders), occupancy_of(chosen), heard)
    if len(senders) < scenario.nodes:
        schedule = schedule.of_nodes(senders, scenario.nodes)
    return _relayed(scenario, schedule)


def senders_of(scenario: Scenario, neighbours: Neighbours) -> tuple[int, ...]:
    """Return the nodes that own slots or contend: all, but those without data where all hear all.

    A node without data has nothing of its own to tell, and no node needs its relay there.
    """
    nodes = range(scenario.nodes)
    mute = definition_of(scenario).without_data(scenario)
    all_hear_all = bool(neighbours) and all(len(one) == len(nodes) - 1 for one in neighbours)
    if not all_hear_all or len(mute) == len(nodes):
        return tuple(nodes)
    return tuple(node for node in nodes if node not in mute)


def _relayed(scenario: Scenario, schedule: Schedule) -> Schedule:
    return msgspec.structs.replace(schedule, relay=latch_delay_of(scenario.rule) is not None)


def plan_bus(scenario: Scenario, share_bytes: int, neighbours: Neighbours = ()) -> Bus:
    """Return the bus of a scenario whose shares have at most that many bytes.

    Raises:
        ValueError: unknown names, unreadable files, or a cluster that does not hold the schedule.
    """
    schedule, chosen = build_schedule(scenario, neighbours), scenario.bus
    wiring = definition_of(scenario).wiring(scenario)
    _check_relay(schedule, chosen)
    request = BusRequest(
        schedule,
        share_bytes,
        arbiter_named(arbiter_of(chosen.schedule)),
        _classes(scenario, schedule),
        latch_delay_of(scenario.rule) or 0.0,
        None if wiring is None else wiring.bid_span,
    )
    if isinstance(chosen, UserBus):
        return user_bus(chosen, schedule, share_bytes, request.arbiter_without_classes)
    return bus_definition(chosen).plan(chosen, request)


def _classes(scenario: Scenario, schedule: Schedule) -> UrgencyClasses:
    """Return the urgency classes of the contenders, from the range in which the rule bids."""
    contenders = {node for row in schedule.contender_table for node in row}
    count = urgency_classes_of(scenario.bus.schedule)
    if count == 1 or not contenders:
        return ONE_CLASS
    least, most = BIDS_FOR_CHANGE
    old_after = len(contenders)
    if isinstance(scenario.rule, FloodingRule):
        # Only here: other rules need nothing of this one.
        from concord.nodes.rules.labelled.record_sets import bids_for_records

        least, most = bids_for_records(scenario.nodes)
        has_scans = definition_of(scenario).wiring(scenario) is not None
        if count >= _LEAST_CLASSES_BY_NEED and not has_scans:
            old_after *= _TURNS_BEFORE_OLD
    return UrgencyClasses(count, least, most, old_after)


def contenders_and_room(bus: Bus) -> tuple[int, int]:
    """Return how many nodes contend on a bus, and how many of their longest shares fit together."""
    contenders = {node for row in bus.schedule.contender_table for node in row}
    room = bus.dynamic_room() if isinstance(bus, FlexRayBus) else len(contenders)
    return len(contenders), room


def _check_relay(schedule: Schedule, bus: SharedBus) -> None:
    if schedule.relay and not isinstance(bus, FlexRay):
        raise ValueError(
            f"--relay --bus {bus.name}: whether a host can latch a frame at its slot depends "
            "on the time between frames; use --bus flexray, or leave --relay out"
        )
