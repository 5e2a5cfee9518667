"""Which node owns which slot: frame ID, channel, and by cycle multiplexing in which cycles.

`allocate` gives a schedule its slots on a cluster.
"""

from collections.abc import Iterable, Sequence

import msgspec

from concord.bus.bus import TooLong
from concord.bus.flexray.channels.plan import (
    ChannelPlan,
    StaticPlace,
    contender_groups,
    on_all,
    static_places,
)
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import Channels, Segment
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.frame import MAX_FRAME_ID
from concord.bus.schedule import Schedule

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
    in each of its sender's slots of a cycle; a contender has such slots in each of `classes`.
    `latest` are nodes with the pLatestTx of their controllers, where that is not the cluster's."""

    assignments: tuple[SlotAssignment, ...]
    first_dynamic_id: int
    static_payloads: tuple[int, ...]
    dynamic_payloads: tuple[int, ...]
    classes: int = 1
    latest: tuple[tuple[int, int], ...] = ()

    def static_slots(self, cycle: int) -> tuple[SlotAssignment, ...]:
        """Static slots in use in this cycle, in order."""
        return tuple(
            slot
            for slot in self.assignments
            if slot.frame_id < self.first_dynamic_id and slot.sends(cycle)
        )

    def static_rows(self, period: int) -> list[list[SlotAssignment]]:
        """Static slots in use in each of so many cycles, in order."""
        rows: list[list[SlotAssignment]] = [[] for _ in range(period)]
        for slot in self.assignments:
            if slot.frame_id < self.first_dynamic_id:
                for cycle in range(slot.base_cycle, period, slot.repetition):
                    rows[cycle].append(slot)
        return rows

    def request(self, node: int, urgency_class: int = 0) -> Request:
        """The request with which this node asks for the dynamic segment for one share."""
        requests = self.requests(urgency_class)
        if node not in requests:
            raise ValueError(f"node {node} owns no dynamic slot; it sends in static slots only")
        return requests[node]

    def requests(self, urgency_class: int = 0) -> dict[int, Request]:
        """The request of each node that owns dynamic slots, in one urgency class."""
        ids: dict[int, list[int]] = {}
        for slot in self.assignments:
            if slot.frame_id >= self.first_dynamic_id:
                ids.setdefault(slot.node, []).append(slot.frame_id)
        first, latest = urgency_class * len(self.dynamic_payloads), dict(self.latest)
        return {
            node: Request(node, sorted(owned)[first], sum(self.dynamic_payloads), latest.get(node))
            for node, owned in ids.items()
        }


def allocate(
    schedule: Schedule,
    cluster: Cluster,
    static_payloads: Sequence[int],
    dynamic_payloads: Sequence[int],
    classes: int = 1,
    plan: ChannelPlan | None = None,
) -> SlotTable:
    """Give every publisher the slots that one share needs: static ones from 1 on, dynamic ones from
    the cluster's first on, class by class of urgency and in order of nodes within each. Without a
    `plan` every frame is on all channels.

    `static_payloads` and `dynamic_payloads` are the payload lengths of the frames in which a share
    travels in either segment (`payload_sizes`); dynamic frames but the last are full.
    Raises ValueError if the cluster has too few static slots, a payload is longer than its frames
    carry, there are more frame IDs than FlexRay has, or a contender could never send.
    """
    contenders = sorted({node for row in schedule.contender_table for node in row})
    if any(schedule.static_table):
        _check_payloads("static", static_payloads, cluster.static_payload_bytes, cluster)
    if contenders:
        _check_payloads("dynamic", dynamic_payloads, cluster.dynamic_payload_bytes, cluster)
    plan = plan or on_all(cluster.channels)
    places = static_places(schedule, len(static_payloads), plan, cluster.sync_slots)
    needed = max((one.first_id + len(static_payloads) - 1 for one in places), default=0)
    if needed > cluster.static_slots:
        raise TooLong(
            f"the schedule needs {needed} static slots in a cycle, {len(static_payloads)} for each "
            f"share in frames of {cluster.static_payload_bytes} bytes, but cluster "
            f"{cluster.name!r} has {cluster.static_slots}; use fewer senders, shorter shares "
            "or another cluster"
        )
    groups = contender_groups(contenders, plan)
    longest = max(len(members) for _, members in groups)
    first, owned = cluster.first_dynamic_id, longest * len(dynamic_payloads)
    if classes > 1 and first + classes * owned - 1 > MAX_FRAME_ID:
        raise ValueError(
            f"{classes} urgency classes of {owned} frame IDs each after {first - 1} static ones, "
            f"but frame IDs end at {MAX_FRAME_ID}; use --urgency-classes "
            f"{max(1, (MAX_FRAME_ID - first + 1) // owned)}, or fewer contenders"
        )
    slots = tuple(_static_assignments(schedule, places, len(static_payloads)))
    dynamic = tuple(
        SlotAssignment(first + rank, node, channel)
        for channel, members in groups
        for rank, node in enumerate([one for one in members for _ in dynamic_payloads] * classes)
    )
    payloads = tuple(static_payloads), tuple(dynamic_payloads)
    table = SlotTable(slots + dynamic, first, *payloads, classes)
    for request in table.requests().values():
        check_reachable(request, cluster)
    return table


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
    schedule: Schedule, places: Sequence[StaticPlace], frames: int
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
                first_id, channel = places[place]
                yield SlotAssignment(first_id + frame, node, channel, base, repetition)


def check_reachable(request: Request, cluster: Cluster) -> None:
    """Check that a contender can send when no other node does.

    Raises:
        ValueError: it cannot.
    """
    if walk(cluster, [request]).waiting:
        raise ValueError(
            f"node {request.node} could never send in dynamic slot {request.frame_id}: "
            f"{request.payload_bytes} bytes from there do not begin by minislot "
            f"{request.latest or cluster.latest_transmission_minislot} (pLatestTx) or end by "
            f"{cluster.minislots} of cluster {cluster.name!r}; use fewer contenders or another "
            "cluster"
        )
