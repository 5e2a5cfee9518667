"""The bus of a scenario: cluster, schedule, slots and arbiter, checked against each other."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from bus import arbitration
from bus.arbitration import Arbiter, ArbiterState
from bus.cluster import Cluster
from bus.cluster_files import FILE_ENDINGS, read_cluster_file
from bus.dynamic_segment import Request
from bus.fitted import fitted_cluster
from bus.presets import PRESETS, preset
from bus.publication import Publications, Slot
from bus.relay import check_relay
from bus.schedule import (
    Schedule,
    dynamic_only,
    full_publish,
    hybrid,
    publishers_per_cycle,
    round_robin,
)
from bus.slot_table import SlotTable, allocate
from bus.timing import check_timing
from nodes.messages import Bid
from nodes.share import CYCLE_COUNTS, payload_lengths
from scenarios.catalogue import kind_of
from scenarios.scenario import Scenario
from topology.names import unknown_name

NO_CLUSTER, FITTED = "none", "fitted"
# The same with every frame on both channels.
REDUNDANT = "fitted-ab"

Neighbours = Sequence[Sequence[int]]


def _leaves_first(nodes: int, neighbours: Neighbours) -> list[int]:
    """Nodes by how many they hear; by number where nobody knows the graph."""
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
_ARBITERS: dict[str, Arbiter] = {
    "wtod": arbitration.wtod,
    "minislot": arbitration.minislot,
    "round-robin": arbitration.round_robin,
}


class BusPlan(NamedTuple):
    """Who may send when, in which slots; `cluster` and `table` are None on a bus without time."""

    schedule: Schedule
    cluster: Cluster | None
    table: SlotTable | None
    slots: Callable[[int, int], tuple[Slot, ...]]

    @property
    def cycle_counts(self) -> int:
        """Where the cycle counter in a frame's header wraps."""
        return CYCLE_COUNTS if self.cluster is None else self.cluster.number_of_cycles


def schedule_names() -> tuple[str, ...]:
    """The schedules there are."""
    return tuple(_SCHEDULES)


def arbiter_names() -> tuple[str, ...]:
    """The arbiters of the dynamic segment there are."""
    return tuple(_ARBITERS)


def cluster_names() -> tuple[str, ...]:
    """What --cluster takes beside files."""
    return (FITTED, REDUNDANT, *PRESETS, NO_CLUSTER)


def build_schedule(scenario: Scenario, neighbours: Neighbours = ()) -> Schedule:
    """Who may publish in which cycle, on a graph that says whom each node hears.

    Raises:
        ValueError: there is no such schedule, or an occupancy below one with a full schedule.
    """
    wiring = kind_of(scenario.name).wiring
    if wiring is not None:
        return wiring.schedule(scenario)
    if scenario.schedule not in _SCHEDULES:
        raise unknown_name("schedule", scenario.schedule, _SCHEDULES)
    if scenario.schedule == "full" and scenario.occupancy < 1:
        raise ValueError(
            f"--schedule full --occupancy {scenario.occupancy:g}: in a full schedule every node "
            "publishes in every cycle; leave --occupancy out, or choose another schedule"
        )
    schedule = _SCHEDULES[scenario.schedule](scenario.nodes, scenario.occupancy, neighbours)
    return msgspec.structs.replace(schedule, relay=scenario.relay)


def has_contenders(scenario: Scenario, neighbours: Neighbours = ()) -> bool:
    """Whether nodes ask for slots that an arbiter awards."""
    return any(build_schedule(scenario, neighbours).dynamic_slot_table)


def plan_bus(scenario: Scenario, share_bytes: int, neighbours: Neighbours = ()) -> BusPlan:
    """The bus of a scenario whose shares have at most that many bytes.

    Raises:
        ValueError: unknown names, unreadable files, or a cluster that does not hold the schedule.
    """
    schedule = build_schedule(scenario, neighbours)
    if scenario.arbiter not in _ARBITERS:
        raise unknown_name("arbiter", scenario.arbiter, _ARBITERS)
    if scenario.cluster == NO_CLUSTER:
        if schedule.relay:
            raise ValueError(
                "--relay True --cluster none: whether a host can latch a frame at its slot depends "
                "on the time between frames; choose a cluster, or leave --relay out"
            )
        return _timeless(schedule, share_bytes)
    cluster = _cluster(scenario, schedule, share_bytes)
    # A cluster fitted to a schedule without static slots has no room for a share in them.
    static: tuple[int, ...] = ()
    if any(schedule.static_table):
        static = payload_lengths(share_bytes, cluster.static_payload_bytes)
    dynamic = payload_lengths(share_bytes, cluster.dynamic_payload_bytes)
    table = allocate(schedule, cluster, static, dynamic)
    if schedule.relay:
        check_relay(schedule, cluster, table, scenario.latch_delay_us)
    return BusPlan(schedule, cluster, table, Publications(table, cluster).slots)


def check_bus(plan: BusPlan, scenario: Scenario, time_step_s: float) -> None:
    """Refuse communication cycles that do not fit the plant's sampling time.

    Raises:
        TimingError: they do not.
    """
    if plan.cluster is not None:
        check_timing(plan.cluster, scenario.rounds, time_step_s, scenario.stretch)


def arbitrate(
    scenario: Scenario, plan: BusPlan
) -> Callable[[ArbiterState, int, tuple[Bid, ...]], tuple[ArbiterState, tuple[int, ...]]]:
    """The world's arbiter: (state, cycle, bids) -> (state, winning nodes in bus order)."""
    return partial(_arbitrate, _ARBITERS[scenario.arbiter], plan)


def _arbitrate(
    arbiter: Arbiter, plan: BusPlan, state: ArbiterState, cycle: int, bids: tuple[Bid, ...]
) -> tuple[ArbiterState, tuple[int, ...]]:
    assert plan.cluster is not None, "a dynamic segment has a cluster: plan_bus refuses the rest"
    requests = [
        Request(bid.node, plan.slots(bid.node, cycle)[0].frame_id, bid.bid, bid.payload_bytes)
        for bid in bids
        if bid.bid is not None
    ]
    slots = plan.schedule.groups(cycle)[bids[0].group].dynamic_slots
    state, winners = arbiter(state, requests, cluster=plan.cluster, slots=slots)
    return state, tuple(winner.node for winner in winners)


def _timeless(schedule: Schedule, share_bytes: int) -> BusPlan:
    """Each node its own consecutive frame IDs in every cycle, and nothing said of time."""
    if any(schedule.dynamic_slot_table):
        raise ValueError(
            "--cluster none: the arbiter of a dynamic segment needs minislots; choose a cluster, "
            "or --schedule full or round-robin"
        )
    lengths = payload_lengths(share_bytes)

    def slots(node: int, _cycle: int) -> tuple[Slot, ...]:
        first = node * len(lengths) + 1
        return tuple(Slot(first + part, length) for part, length in enumerate(lengths))

    return BusPlan(schedule, None, None, slots)


def _cluster(scenario: Scenario, schedule: Schedule, share_bytes: int) -> Cluster:
    name = scenario.cluster
    if name == FITTED:
        return _fitted(schedule, share_bytes)
    if name == REDUNDANT:
        return msgspec.structs.replace(_fitted(schedule, share_bytes), channels="AB")
    if name in PRESETS:
        return preset(name)
    path = Path(name)
    if path.suffix not in FILE_ENDINGS:
        raise unknown_name("cluster", name, (*cluster_names(), "FILE.toml", "FILE.xml"))
    return read_cluster_file(path)


def _fitted(schedule: Schedule, share_bytes: int) -> Cluster:
    try:
        return fitted_cluster(schedule, payload_lengths(share_bytes))
    except ValueError as error:
        senders = max(
            len(schedule.static_senders(cycle)) + schedule.dynamic_slots(cycle)
            for cycle in range(schedule.period)
        )
        raise ValueError(
            f"no FlexRay cycle (16 ms at most) holds {senders} shares of {share_bytes} bytes; "
            "lower --occupancy, use --number float32, or --cluster none for a bus without time "
            f"({error})"
        ) from None
