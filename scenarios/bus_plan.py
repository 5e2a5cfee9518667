"""The bus of a scenario: schedule, cluster and arbiter, checked against each other."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from concord.bus.arbitration import ARBITERS, Arbiter
from concord.bus.bus import Bus
from concord.bus.flexray.channels.plan import ChannelPlan, channel_plan
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_files import FILE_ENDINGS, read_cluster_file
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import FlexRayBus, flexray_bus, written_bus
from concord.bus.flexray.message_slot import MessageSlot
from concord.bus.flexray.presets import PRESETS, preset
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.flexray.slot_file import read_slot_file
from concord.bus.flexray.written_slots import written_schedule
from concord.bus.ideal import TimelessBus
from concord.bus.schedule import (
    Schedule,
    dynamic_only,
    full_publish,
    hybrid,
    publishers_per_cycle,
    round_robin,
)
from concord.bus.urgency_classes import ONE_CLASS, UrgencyClasses
from concord.features.other_buses.can_fd.bits import IDENTIFIER_BITS, Rates
from concord.features.other_buses.can_fd.can_fd_bus import can_fd_bus
from concord.features.other_buses.plca.cycle import PlcaSettings
from concord.features.other_buses.plca.plca_bus import PlcaBus
from concord.nodes.bids import BIDS_FOR_CHANGE
from concord.nodes.rules.labelled.record_sets import bids_for_records
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import (
    ALL_CHANNELS,
    CanFd,
    FlexRay,
    Ideal,
    Plca,
    SharedBus,
    UserBus,
    WrittenSchedule,
    arbiter_of,
    occupancy_of,
    urgency_classes_of,
)
from concord.scenarios.types.rules import FloodingRule, latch_delay_of
from concord.scenarios.user.arbiter import arbiter_named
from concord.scenarios.user.bus import user_bus
from concord.topology.names import unknown_name

# Nodes that pass records on ask in most cycles. If each were old after a turn of all, slots would
# go by age and not by need. Two classes leave one for all needs: there only age tells nodes apart.
# Scans, which are the records of a wiring, come sooner with an age of one turn (docs/targets.md).
_TURNS_BEFORE_OLD, _LEAST_CLASSES_BY_NEED = 12, 3
FITTED = "fitted"
# The same with every frame on both channels.
REDUNDANT = "fitted-ab"

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
    """The arbiters of the dynamic segment there are."""
    return tuple(ARBITERS)


def cluster_names() -> tuple[str, ...]:
    """Return the names that --cluster accepts beside files."""
    return (FITTED, REDUNDANT, *PRESETS)


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
        cluster, slots = _written(scenario.bus, chosen)
        with _naming(chosen.slots):
            schedule = written_schedule(slots, cluster, scenario.nodes)
        return _relayed(scenario, schedule)
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


@contextmanager
def _naming(slots: str) -> Iterator[None]:
    """Say which slot table is wrong."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"--slots {slots}: {error}") from None


def _written(bus: FlexRay, schedule: WrittenSchedule) -> tuple[Cluster, tuple[MessageSlot, ...]]:
    """Return the cluster and the slots of a bus with a written table.

    Raises:
        ValueError: there is no such table, or no cluster that it could be of.
    """
    if not schedule.slots:
        raise ValueError("--schedule written: name its slot table with --slots FILE.toml")
    if bus.cluster in (FITTED, REDUNDANT):
        raise ValueError(
            f"--cluster {bus.cluster}: a slot table belongs to one cluster; name it, as a preset "
            f"({', '.join(PRESETS)}) or a file"
        )
    cluster = _named_cluster(bus.cluster)
    with _naming(schedule.slots):
        return cluster, read_slot_file(Path(schedule.slots), cluster)


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
    return _BUSES[type(chosen)](chosen, request)


class BusRequest(NamedTuple):
    """The schedule of a bus, the longest share in bytes, and how nodes contend.

    bid_span: as `NetworkWiring.bid_span`.
    """

    schedule: Schedule
    share_bytes: int
    arbiter: Arbiter
    classes: UrgencyClasses
    latch_delay_us: float
    bid_span: tuple[int, int] | None = None

    @property
    def arbiter_without_classes(self) -> Arbiter:
        """The arbiter of a bus on which a node has one identifier: the most urgent bid wins."""
        return ARBITERS["wtod"] if self.arbiter.by_class else self.arbiter


def _flexray(chosen: FlexRay, asked: BusRequest) -> Bus:
    if not chosen.withdrawal:
        _check_cuts(chosen, asked)
        asked = asked._replace(arbiter=asked.arbiter._replace(withdraws=False, cuts=True))
    if isinstance(chosen.schedule, WrittenSchedule):
        cluster, slots = _written(chosen, chosen.schedule)
        _check_no_written_relay(asked.schedule)
        _check_no_written_channels(chosen)
        with _naming(chosen.schedule.slots):
            return written_bus(slots, cluster, asked.schedule, asked.share_bytes, asked.arbiter)
    cluster, plan = _cluster(chosen, asked)
    return flexray_bus(
        asked.schedule,
        cluster,
        asked.share_bytes,
        asked.arbiter,
        asked.latch_delay_us,
        asked.classes,
        plan,
    )


def _plca(chosen: Plca, asked: BusRequest) -> Bus:
    timing = PlcaSettings(chosen.opportunity_bits, chosen.burst_frames)
    return PlcaBus(asked.schedule, asked.share_bytes, asked.arbiter_without_classes, timing)


def _can_fd(chosen: CanFd, asked: BusRequest) -> Bus:
    bits = IDENTIFIER_BITS[chosen.identifiers]
    rates = Rates(bits, chosen.nominal_kbit_s, chosen.data_kbit_s)
    return can_fd_bus(
        asked.schedule,
        asked.share_bytes,
        asked.arbiter,
        asked.classes,
        rates,
        asked.bid_span,
        chosen.retransmissions,
    )


def _ideal(chosen: Ideal, asked: BusRequest) -> Bus:
    _check_timeless(asked.schedule)
    return TimelessBus(asked.schedule, asked.share_bytes)


def _user(chosen: UserBus, asked: BusRequest) -> Bus:
    return user_bus(chosen, asked.schedule, asked.share_bytes, asked.arbiter_without_classes)


_BUSES: dict[type[SharedBus], Callable[[Any, BusRequest], Bus]] = {
    FlexRay: _flexray,
    Plca: _plca,
    CanFd: _can_fd,
    Ideal: _ideal,
    UserBus: _user,
}


def _classes(scenario: Scenario, schedule: Schedule) -> UrgencyClasses:
    """Return the urgency classes of the contenders, from the range in which the rule bids."""
    contenders = {node for row in schedule.contender_table for node in row}
    count = urgency_classes_of(scenario.bus.schedule)
    if count == 1 or not contenders:
        return ONE_CLASS
    least, most = BIDS_FOR_CHANGE
    old_after = len(contenders)
    if isinstance(scenario.rule, FloodingRule):
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


def _check_timeless(schedule: Schedule) -> None:
    """Refuse what a bus without time cannot say.

    Raises:
        ValueError: naming the options and the cure.
    """
    if any(schedule.dynamic_slot_table):
        raise ValueError(
            "--bus ideal: the arbiter of a dynamic segment needs minislots; use --bus flexray, "
            "or --schedule full or round-robin"
        )


def _check_relay(schedule: Schedule, bus: SharedBus) -> None:
    if schedule.relay and not isinstance(bus, FlexRay):
        raise ValueError(
            f"--relay --bus {bus.name}: whether a host can latch a frame at its slot depends "
            "on the time between frames; use --bus flexray, or leave --relay out"
        )


def _check_cuts(chosen: FlexRay, asked: BusRequest) -> None:
    """Refuse hosts that do not withdraw where no controller could send what they leave."""
    arbiter, schedule = arbiter_of(chosen.schedule), asked.schedule
    if not any(schedule.contender_table):
        raise ValueError(
            "--no-withdrawal: no node contends for the dynamic segment; use --schedule dynamic or "
            "hybrid, or leave --no-withdrawal out"
        )
    if asked.arbiter.is_ideal:
        raise ValueError(
            f"--no-withdrawal --arbiter {arbiter}: an ideal arbiter awards whole shares, which no "
            "controller does; use --arbiter urgency or minislot, or leave --no-withdrawal out"
        )
    if schedule.relay:
        raise ValueError(
            "--no-withdrawal --relay: with --relay a host composes each frame in its slot, and "
            "leaves none in its buffers; leave one of the two out"
        )


def _check_no_written_relay(schedule: Schedule) -> None:
    if schedule.relay:
        raise ValueError(
            "--relay --schedule written: a host latches its frame in the slot order that "
            "concord gives; use another --schedule, or leave --relay out"
        )


def _check_no_written_channels(chosen: FlexRay) -> None:
    if chosen.channels != ALL_CHANNELS:
        raise ValueError(
            f"--channels {chosen.channels} --schedule written: the slot table says which channel "
            "carries a frame; leave --channels out, or use another --schedule"
        )


def _cluster(chosen: FlexRay, asked: BusRequest) -> tuple[Cluster, ChannelPlan]:
    """Return the cluster, and the channels of the shares on it."""
    name = chosen.cluster
    if name not in (FITTED, REDUNDANT):
        cluster = _named_cluster(name)
        return cluster, channel_plan(chosen.channels, cluster.channels, name)
    channels: Channels = "A" if name == FITTED else "AB"
    plan = channel_plan(chosen.channels, channels, name)
    fitted = _fitted(asked.schedule, asked.share_bytes, asked.classes.count, plan)
    return msgspec.structs.replace(fitted, channels=channels), plan


def _named_cluster(name: str) -> Cluster:
    """Return the cluster of a preset or a file."""
    if name in PRESETS:
        return preset(name)
    path = Path(name)
    if path.suffix not in FILE_ENDINGS:
        raise unknown_name(
            "cluster", name, (*cluster_names(), "FILE.toml", "FILE.xml", "FILE.arxml")
        )
    return read_cluster_file(path)


def _fitted(schedule: Schedule, share_bytes: int, classes: int, plan: ChannelPlan) -> Cluster:
    try:
        return fitted_cluster(schedule, payload_lengths(share_bytes), classes, plan)
    except ValueError as error:
        senders = max(
            len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
            for cycle in range(schedule.period)
        )
        raise ValueError(
            f"no FlexRay cycle (16 ms at most) holds {senders} shares of {share_bytes} bytes"
            + (f" and frame IDs of {classes} urgency classes" if classes > 1 else "")
            + "; lower --occupancy"
            + (" or --urgency-classes" if classes > 1 else "")
            + ", use --number float32, or --bus ideal for a bus without time "
            f"({error})"
        ) from None
