"""The bus of a scenario: schedule, cluster and arbiter, checked against each other."""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from bus.arbitration import ARBITERS
from bus.bus import Bus, FrameFormat
from bus.flexray.cluster import Cluster
from bus.flexray.cluster_files import FILE_ENDINGS, read_cluster_file
from bus.flexray.fitted import fitted_cluster
from bus.flexray.flexray_bus import flexray_bus
from bus.flexray.presets import PRESETS, preset
from bus.flexray.share_frames import SHARE_FRAMES, payload_lengths
from bus.ideal import TimelessBus
from bus.schedule import (
    Schedule,
    dynamic_only,
    full_publish,
    hybrid,
    publishers_per_cycle,
    round_robin,
)
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


def schedule_names() -> tuple[str, ...]:
    """The schedules there are."""
    return tuple(_SCHEDULES)


def arbiter_names() -> tuple[str, ...]:
    """The arbiters of the dynamic segment there are."""
    return tuple(ARBITERS)


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


def plan_bus(scenario: Scenario, share_bytes: int, neighbours: Neighbours = ()) -> Bus:
    """Return the bus of a scenario whose shares have at most that many bytes.

    Raises:
        ValueError: unknown names, unreadable files, or a cluster that does not hold the schedule.
    """
    schedule = build_schedule(scenario, neighbours)
    if scenario.arbiter not in ARBITERS:
        raise unknown_name("arbiter", scenario.arbiter, ARBITERS)
    if scenario.cluster == NO_CLUSTER:
        _check_timeless(schedule)
        return TimelessBus(schedule, share_bytes)
    cluster = _cluster(scenario, schedule, share_bytes)
    arbiter = ARBITERS[scenario.arbiter]
    return flexray_bus(schedule, cluster, share_bytes, arbiter, scenario.latch_delay_us)


def frame_format(scenario: Scenario) -> FrameFormat:
    """Return how the frames of a scenario's bus carry shares."""
    return SHARE_FRAMES


def _check_timeless(schedule: Schedule) -> None:
    """Refuse what a bus without time cannot say.

    Raises:
        ValueError: naming the options and the cure.
    """
    if schedule.relay:
        raise ValueError(
            "--relay True --cluster none: whether a host can latch a frame at its slot depends "
            "on the time between frames; choose a cluster, or leave --relay out"
        )
    if any(schedule.dynamic_slot_table):
        raise ValueError(
            "--cluster none: the arbiter of a dynamic segment needs minislots; choose a cluster, "
            "or --schedule full or round-robin"
        )


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
