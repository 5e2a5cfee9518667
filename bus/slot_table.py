"""Which node owns which slot: frame ID, channel, and by cycle multiplexing in which cycles.

`allocate` gives a schedule its slots on a cluster; `schedule_from_slots` goes the other way, from
a slot table that somebody wrote (or a car has) to a schedule.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations
from math import gcd, lcm

import msgspec

from bus.cluster import Channels, Cluster, Segment
from bus.dynamic_segment import Request, walk
from bus.frame import MAX_FRAME_ID
from bus.schedule import Schedule

REPETITIONS = (1, 2, 4, 8, 16, 32, 64)
"""Cycle repetitions that every FlexRay controller has."""


class SlotAssignment(msgspec.Struct, frozen=True):
    """Node `node` sends frame `frame_id` in the cycles with `cycle % repetition == base_cycle`."""

    frame_id: int
    node: int
    channel: Channels = "A"
    base_cycle: int = 0
    repetition: int = 1

    def sends(self, cycle: int) -> bool:
        return cycle % self.repetition == self.base_cycle


class SlotTable(msgspec.Struct, frozen=True):
    """A schedule's slots on a cluster. A share travels in frames with payloads of these bytes, one
    in each of its sender's slots of a cycle."""

    assignments: tuple[SlotAssignment, ...]
    first_dynamic_id: int
    static_payloads: tuple[int, ...]
    dynamic_payloads: tuple[int, ...]

    def static_slots(self, cycle: int) -> tuple[SlotAssignment, ...]:
        """Static slots in use in this cycle, in order."""
        return tuple(
            slot
            for slot in self.assignments
            if slot.frame_id < self.first_dynamic_id and slot.sends(cycle)
        )

    def request(self, node: int, bid: int) -> Request:
        """The request with which this node asks for the dynamic segment for one share."""
        ids = [
            slot.frame_id
            for slot in self.assignments
            if slot.node == node and slot.frame_id >= self.first_dynamic_id
        ]
        if not ids:
            raise ValueError(f"node {node} owns no dynamic slot; it sends in static slots only")
        return Request(node, min(ids), bid, sum(self.dynamic_payloads))


def allocate(
    schedule: Schedule,
    cluster: Cluster,
    static_payloads: Sequence[int],
    dynamic_payloads: Sequence[int],
) -> SlotTable:
    """Give every publisher the slots that one share needs: static ones from 1 on, dynamic ones from
    the cluster's first on, in order of nodes.

    `static_payloads` and `dynamic_payloads` are the payload lengths of the frames in which a share
    travels in either segment (`bus.fragments.payload_sizes`); dynamic frames but the last are full.
    Raises ValueError if the cluster has too few static slots, a payload is longer than its frames
    carry, or a contender could never send.
    """
    contenders = sorted({node for row in schedule.contender_table for node in row})
    if any(schedule.static_table):
        _check_payloads("static", static_payloads, cluster.static_payload_bytes, cluster)
    if contenders:
        _check_payloads("dynamic", dynamic_payloads, cluster.dynamic_payload_bytes, cluster)
    slots = tuple(_static_assignments(schedule, cluster.channels, len(static_payloads)))
    needed = max((slot.frame_id for slot in slots), default=0)
    if needed > cluster.static_slots:
        raise ValueError(
            f"the schedule needs {needed} static slots in a cycle, {len(static_payloads)} for each "
            f"share in frames of {cluster.static_payload_bytes} bytes, but cluster "
            f"{cluster.name!r} has {cluster.static_slots}; lower the occupancy, use float32, or "
            "another cluster"
        )
    first = cluster.first_dynamic_id
    dynamic = tuple(
        SlotAssignment(first + rank, node, cluster.channels)
        for rank, node in enumerate(node for node in contenders for _ in dynamic_payloads)
    )
    table = SlotTable(slots + dynamic, first, tuple(static_payloads), tuple(dynamic_payloads))
    for node in contenders:
        _check_reachable(table.request(node, 0), cluster)
    return table


def schedule_from_slots(
    nodes: int,
    assignments: Iterable[SlotAssignment],
    cluster: Cluster,
    dynamic_slots: int | None = None,
) -> Schedule:
    """The schedule that a written slot table gives; a node may own several slots of a cycle.

    `dynamic_slots` limits how many contenders win in a cycle (None: the segment alone does). Raises
    ValueError for slots with two owners, or that the cluster or the network does not have.
    """
    slots = sorted(assignments, key=lambda slot: slot.frame_id)
    for slot in slots:
        _check_assignment(slot, nodes, cluster)
    _check_single_owners(slots)
    static = [slot for slot in slots if slot.frame_id <= cluster.static_slots]
    dynamic = [slot for slot in slots if slot.frame_id > cluster.static_slots]
    contenders = _rows(dynamic)
    limit = nodes if dynamic_slots is None else dynamic_slots
    winners = tuple(min(limit, len(row)) for row in contenders)
    return Schedule(nodes, _rows(static), contenders, winners)


def deviations(assignments: Iterable[SlotAssignment], cluster: Cluster) -> tuple[str, ...]:
    """Where a table asks for more than cycle multiplexing can do, one sentence per frame ID."""
    slots = [
        slot
        for slot in assignments
        if slot.repetition not in REPETITIONS or cluster.number_of_cycles % slot.repetition
    ]
    repetitions = {slot.frame_id: slot.repetition for slot in slots}
    return tuple(
        f"slot {frame_id} changes owner with a period of {repetition} cycles, but controllers "
        f"repeat every 1, 2, 4, ..., 64 cycles and count {cluster.number_of_cycles}; the hosts "
        "must reassign the slot; or choose slots per cycle so that nodes / slots is a power of 2"
        for frame_id, repetition in sorted(repetitions.items())
    )


def _check_payloads(
    segment: Segment, payloads: Sequence[int], limit: int, cluster: Cluster
) -> None:
    full = segment == "static" or all(size == limit for size in payloads[:-1])
    if not payloads or max(payloads) > limit or not full:
        raise ValueError(
            f"a share in {segment} frames of {list(payloads)} bytes, but those of cluster "
            f"{cluster.name!r} carry {limit} bytes and all but the last must be full; split it for "
            "this cluster"
        )


def _static_assignments(
    schedule: Schedule, channel: Channels, frames: int
) -> Iterable[SlotAssignment]:
    """Slots of each turn; a node that comes back at equal intervals gets one multiplexed entry."""
    period = len(schedule.static_table)
    turns: dict[tuple[int, int], list[int]] = {}
    for cycle, row in enumerate(schedule.static_table):
        for place, node in enumerate(row):
            turns.setdefault((place, node), []).append(cycle)
    for (place, node), cycles in sorted(turns.items()):
        spacing, rest = divmod(period, len(cycles))
        even = not rest and cycles == list(range(cycles[0], period, spacing))
        repetition = spacing if even else period
        for base in cycles[:1] if even else cycles:
            for frame in range(frames):
                frame_id = place * frames + frame + 1
                yield SlotAssignment(frame_id, node, channel, base, repetition)


def _rows(slots: Sequence[SlotAssignment]) -> tuple[tuple[int, ...], ...]:
    """Nodes that own one of the slots, in slot order, for each cycle of a period."""
    period = lcm(*(slot.repetition for slot in slots))
    return tuple(
        tuple(dict.fromkeys(slot.node for slot in slots if slot.sends(cycle)))
        for cycle in range(period)
    )


def _check_assignment(slot: SlotAssignment, nodes: int, cluster: Cluster) -> None:
    if not 0 <= slot.node < nodes:
        raise ValueError(
            f"slot {slot.frame_id} belongs to node {slot.node}, but there are nodes 0..{nodes - 1}"
        )
    if slot.repetition not in REPETITIONS or not 0 <= slot.base_cycle < slot.repetition:
        raise ValueError(
            f"slot {slot.frame_id} of node {slot.node} has base cycle {slot.base_cycle} and "
            f"repetition {slot.repetition}; the repetition must be 1, 2, 4, ..., 64 and the base "
            "cycle below it"
        )
    if not set(slot.channel) <= set(cluster.channels):
        raise ValueError(
            f"slot {slot.frame_id} of node {slot.node} uses channel {slot.channel}, but cluster "
            f"{cluster.name!r} has {cluster.channels}"
        )
    if not 1 <= slot.frame_id <= MAX_FRAME_ID:
        raise ValueError(
            f"slot {slot.frame_id} of node {slot.node} does not exist; frame IDs are "
            f"1..{MAX_FRAME_ID}"
        )
    if slot.frame_id > cluster.static_slots:
        _check_reachable(Request(slot.node, slot.frame_id, 0, 0), cluster)


def _check_single_owners(slots: Sequence[SlotAssignment]) -> None:
    by_id: dict[int, list[SlotAssignment]] = {}
    for slot in slots:
        by_id.setdefault(slot.frame_id, []).append(slot)
    for rivals in by_id.values():
        for one, other in combinations(rivals, 2):
            shared = set(one.channel) & set(other.channel)
            # Both send in one cycle if and only if their bases agree modulo the common divisor.
            common = gcd(one.repetition, other.repetition)
            if shared and (one.base_cycle - other.base_cycle) % common == 0:
                raise ValueError(
                    f"slot {one.frame_id} on channel {''.join(sorted(shared))} has two owners, "
                    f"node {one.node} (base {one.base_cycle}, repetition {one.repetition}) and "
                    f"node {other.node} (base {other.base_cycle}, repetition {other.repetition}); "
                    "give them different slots, channels or cycles"
                )


def _check_reachable(request: Request, cluster: Cluster) -> None:
    """A contender must be able to send when nobody else does."""
    if walk(cluster, [request]).waiting:
        raise ValueError(
            f"node {request.node} could never send in dynamic slot {request.frame_id}: "
            f"{request.payload_bytes} bytes from there do not begin by minislot "
            f"{cluster.latest_transmission_minislot} (pLatestTx) or end by {cluster.minislots} of "
            f"cluster {cluster.name!r}; use fewer contenders or another cluster"
        )
