"""When what is on the bus: frames and segments of a cycle in microseconds, load, what fits."""

from collections.abc import Iterable

from concord.bus.bus import SegmentTime, Transmission
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.slot_table import SlotAssignment, SlotTable
from concord.bus.schedule import Schedule


class TimingError(ValueError):
    """The communication cycles of a step do not fit into the plant's sampling time."""


def static_transmissions(
    cluster: Cluster, slots: Iterable[SlotAssignment]
) -> tuple[Transmission, ...]:
    """Static frames: each begins at the action point of its slot and has the static payload."""
    duration_us = cluster.frame_us(cluster.static_payload_bytes)
    starts = [
        (slot, cluster.slot_start_us(slot.frame_id) + cluster.action_point_us) for slot in slots
    ]
    return tuple(
        Transmission(
            node=slot.node,
            frame_id=slot.frame_id,
            channel=slot.channel,
            segment="static",
            payload_bytes=cluster.static_payload_bytes,
            start_us=start_us,
            end_us=start_us + duration_us,
        )
        for slot, start_us in starts
    )


def dynamic_transmissions(
    cluster: Cluster, winners: Iterable[Request], channel: str = ""
) -> tuple[Transmission, ...]:
    """Dynamic frames on a channel, without one on all of the cluster: each begins at the action
    point of its minislot. Those that find no room in the segment wait, and are left out."""
    placed, _ = walk(cluster, winners)
    starts = [
        (frame, cluster.minislot_start_us(frame.minislot) + cluster.minislot_action_point_us)
        for frame in placed
    ]
    return tuple(
        Transmission(
            node=frame.node,
            frame_id=frame.frame_id,
            channel=channel or cluster.channels,
            segment="dynamic",
            payload_bytes=frame.payload_bytes,
            start_us=start_us,
            end_us=start_us + cluster.frame_us(frame.payload_bytes),
            minislot=frame.minislot,
        )
        for frame, start_us in starts
    )


def segments(cluster: Cluster) -> tuple[SegmentTime, ...]:
    """The segments of a cycle, in order; they meet, and those of no length are left out."""
    lengths = {
        "static": cluster.static_slots * cluster.static_slot_macroticks,
        "dynamic": cluster.action_point_difference_macroticks
        + cluster.minislots * cluster.minislot_macroticks,
        "symbol window": cluster.symbol_window_macroticks,
        "network idle time": cluster.network_idle_time_macroticks,
    }
    parts: list[SegmentTime] = []
    macroticks = 0
    for name, length in lengths.items():
        start_us = macroticks * cluster.macrotick_us
        macroticks += length
        if length:
            parts.append(SegmentTime(name, start_us, macroticks * cluster.macrotick_us))
    return tuple(parts)


def bus_load(cluster: Cluster, transmissions: Iterable[Transmission], channel: str = "A") -> float:
    """Share of the cycle in which a channel carries frames, 0..1."""
    busy = sum(frame.end_us - frame.start_us for frame in transmissions if channel in frame.channel)
    return busy / cluster.cycle_us


def fusion_delay_us(cluster: Cluster, rounds: int, last_cycle: Iterable[Transmission]) -> float:
    """From the beginning of a step's first cycle to the end of its last share."""
    end_us = max((frame.end_us for frame in last_cycle), default=0.0)
    return (rounds - 1) * cluster.cycle_us + end_us


def stretch_needed(cluster: Cluster, rounds: int, time_step_s: float) -> float:
    """Factor by which the sampling time must grow to hold the cycles of a step; 1 if they fit."""
    return max(1.0, rounds * cluster.cycle_time_s / time_step_s)


def check_timing(cluster: Cluster, rounds: int, time_step_s: float, stretch: float = 1.0) -> None:
    """Refuse a step whose communication cycles last longer than the (stretched) sampling time.

    Raises TimingError, which says by which stretch, rounds or cycle time they would fit.
    """
    if rounds < 1 or not time_step_s > 0 or not stretch > 0:
        raise TimingError(
            f"rounds ({rounds}), time step ({time_step_s} s) and stretch ({stretch}) must be "
            "positive"
        )
    needed = stretch_needed(cluster, rounds, time_step_s)
    # Products of decimals differ in the last bits; a microtick is far more than that.
    spare_s = stretch * time_step_s - rounds * cluster.cycle_time_s
    if spare_s >= -1e-6 * cluster.microtick_us:
        return
    fitting = int(stretch * time_step_s / cluster.cycle_time_s)
    fewer = f"--rounds {fitting}, " if fitting else ""
    raise TimingError(
        f"{rounds} rounds are {rounds} communication cycles of {cluster.cycle_us / 1e3:g} ms = "
        f"{rounds * cluster.cycle_us / 1e3:g} ms on cluster {cluster.name!r}, but the plant is "
        f"sampled every {stretch * time_step_s * 1e3:g} ms; use {fewer}--stretch {needed:.4g}, or "
        f"a cluster with cycles of at most {stretch * time_step_s * 1e3 / rounds:.4g} ms"
    )


def check_relay(
    schedule: Schedule, cluster: Cluster, table: SlotTable, latch_delay_us: float
) -> None:
    """Refuse relaying within a cycle on a cluster that leaves no time for it.

    A host can relay if it needs no longer than `latch_delay_us` from the last bit of a frame to
    having composed the next, which may begin in the very next slot. The dynamic slots of a relaying
    schedule are awarded one by one, so every choice of winners must fit into the segment.

    Raises:
        ValueError: naming the time there is, and the cure.
    """
    time_us = least_gap_us(schedule, cluster)
    if latch_delay_us > time_us:
        raise ValueError(
            f"--relay with --latch-delay-us {latch_delay_us:g}: cluster {cluster.name!r} "
            f"leaves {time_us:.3g} us from the last bit of a frame to the first of the next, and a "
            "host must have read the one and composed the other by then; leave --relay out, or "
            "use a cluster with longer slots or minislots"
        )
    slots = max(schedule.dynamic_slot_table)
    contenders = sorted({node for row in schedule.contender_table for node in row})
    if not (slots and contenders):
        return
    # The last IDs are the worst: every slot before them counts by empty.
    requests = table.requests(table.classes - 1)
    worst = [requests[node] for node in contenders[-slots:]]
    waiting = walk(cluster, worst).waiting
    if waiting:
        raise ValueError(
            f"--relay: the dynamic segment of cluster {cluster.name!r} holds "
            f"{len(worst) - len(waiting)} of {len(worst)} of the longest shares, but slots that "
            "are awarded one by one must fit whoever wins; lower --occupancy or --payload-bytes, "
            "or use --cluster fitted"
        )


def least_gap_us(schedule: Schedule, cluster: Cluster) -> float:
    """The shortest time between two frames that may follow each other, last bit to first bit."""
    gaps: list[float] = []
    if any(schedule.static_table):
        gaps.append(cluster.static_slot_us - cluster.frame_us(cluster.static_payload_bytes))
    if any(schedule.dynamic_slot_table):
        # However long a frame is, its slot ends with the minislots in which idle is seen.
        idle = 1 + cluster.dynamic_slot_idle_phase_minislots
        gaps.append(idle * cluster.minislot_us)
    return min(gaps, default=float("inf"))
