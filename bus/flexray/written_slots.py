"""A written slot table as the schedule of a network, and a network's slots as a written table.

Nodes 0 to N - 1 of the table are those of the network; higher numbers are other stations of the
bus. A node publishes in the cycles of its static slots, and contends in those of its dynamic ones.
"""

from collections import defaultdict
from collections.abc import Sequence
from math import lcm

from concord.bus.arbitration import ONE_CLASS, Arbiter
from concord.bus.bus import TooLong
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.flexray.slot_table import SlotAssignment, SlotTable, check_reachable, deviations
from concord.bus.schedule import Schedule


def written_schedule(slots: Sequence[MessageSlot], cluster: Cluster, nodes: int) -> Schedule:
    """Return which of so many nodes own static slots in each cycle, and which contend.

    Raises:
        ValueError: a node has no slot, or both a static and a dynamic one in a cycle.
    """
    silent = sorted(set(range(nodes)) - {slot.node for slot in slots})
    if silent:
        raise ValueError(
            f"nodes {', '.join(map(str, silent[:9]))}{', ...' * (len(silent) > 9)} of {nodes} own "
            "no slot; give each node a slot, or use fewer --nodes"
        )
    own = [slot for slot in slots if slot.node < nodes]
    period = lcm(*(slot.repetition for slot in own))
    static: list[list[int]] = [[] for _ in range(period)]
    contenders: list[set[int]] = [set() for _ in range(period)]
    for slot in sorted(own, key=lambda one: one.frame_id):
        for cycle in range(slot.base_cycle, period, slot.repetition):
            if slot.frame_id >= cluster.first_dynamic_id:
                contenders[cycle].add(slot.node)
            elif slot.node not in static[cycle]:
                static[cycle].append(slot.node)
    for cycle, (senders, asking) in enumerate(zip(static, contenders, strict=True)):
        for node in sorted(asking.intersection(senders))[:1]:
            raise ValueError(
                f"node {node} owns static and dynamic slots in cycle {cycle}; a share takes one "
                "kind, so give the others to another node"
            )
    return Schedule(
        nodes,
        tuple(map(tuple, static)),
        tuple(tuple(sorted(asking)) for asking in contenders),
        tuple(map(len, contenders)),
    )


def written_table(
    slots: Sequence[MessageSlot],
    cluster: Cluster,
    nodes: int,
    static_payloads: Sequence[int],
    dynamic_payloads: Sequence[int],
) -> SlotTable:
    """Return the slots in which shares travel in frames with payloads of these bytes.

    A share takes the first slots of its sender in a cycle; others stay empty.

    Raises:
        ValueError: a node owns too few slots for a share, too short ones, or one frame ID on each
            channel; or some dynamic slots are on both channels and others on one.
    """
    own = [slot for slot in slots if slot.node < nodes]
    first = cluster.first_dynamic_id
    _check_channels(own, cluster)
    static = [slot for slot in own if slot.frame_id < first]
    _check_static(static, cluster, len(static_payloads))
    dynamic = _contended([slot for slot in own if slot.frame_id >= first], dynamic_payloads)
    return SlotTable(
        tuple(
            SlotAssignment(slot.frame_id, slot.node, slot.channel, slot.base_cycle, slot.repetition)
            for slot in (*static, *dynamic)
        ),
        first,
        tuple(static_payloads),
        tuple(dynamic_payloads),
        latest=tuple(
            (slot.node, slot.latest_transmission_minislot)
            for slot in dynamic
            if slot.latest_transmission_minislot is not None
        ),
    )


def other_stations(
    slots: Sequence[MessageSlot], cluster: Cluster, nodes: int
) -> tuple[MessageSlot, ...]:
    """Return the slots of stations that are no nodes of the network.

    Raises:
        ValueError: such a station shares a dynamic frame ID with a node.
    """
    others = tuple(slot for slot in slots if slot.node >= nodes)
    mine = {
        (slot.frame_id, letter) for slot in slots if slot.node < nodes for letter in slot.channel
    }
    for slot in others:
        meets = any((slot.frame_id, letter) in mine for letter in slot.channel)
        if slot.frame_id >= cluster.first_dynamic_id and meets:
            raise ValueError(
                f"frame ID {slot.frame_id}: station {slot.node} takes turns with a node of the "
                f"network (0 to {nodes - 1}) in a dynamic slot; give the node an ID of its own"
            )
    return others


def message_slots(table: SlotTable, cluster: Cluster) -> tuple[MessageSlot, ...]:
    """Return the slots of a network as a table to write, in order of frame IDs.

    Raises:
        ValueError: a slot changes its owner at intervals that no controller repeats.
    """
    beyond = deviations(table.assignments, cluster)
    if beyond:
        raise ValueError(f"the slots cannot be written: {beyond[0]}")
    ids: dict[int, list[int]] = defaultdict(list)
    for slot in table.assignments:
        if slot.frame_id >= table.first_dynamic_id:
            ids[slot.node].append(slot.frame_id)
    frames, latest = len(table.dynamic_payloads), dict(table.latest)
    places = {
        (node, frame_id): divmod(place, frames)
        for node, owned in ids.items()
        for place, frame_id in enumerate(sorted(owned))
    }
    return tuple(
        MessageSlot(
            frame_id=slot.frame_id,
            payload_bytes=table.dynamic_payloads[places[slot.node, slot.frame_id][1]]
            if slot.frame_id >= table.first_dynamic_id
            else cluster.static_payload_bytes,
            node=slot.node,
            channel=slot.channel,
            base_cycle=slot.base_cycle,
            repetition=slot.repetition,
            urgency_class=places.get((slot.node, slot.frame_id), (0, 0))[0],
            latest_transmission_minislot=latest.get(slot.node)
            if slot.frame_id >= table.first_dynamic_id
            else None,
        )
        for slot in sorted(table.assignments, key=lambda one: (one.frame_id, one.base_cycle))
    )


def _check_channels(slots: Sequence[MessageSlot], cluster: Cluster) -> None:
    """Check that each frame ID of a node, and each slot counter, has one kind of channel."""
    channels: dict[tuple[int, int], str] = {}
    for slot in slots:
        if not set(slot.channel) <= set(cluster.channels):
            raise ValueError(
                f"frame ID {slot.frame_id} of node {slot.node}: channel is {slot.channel}, but "
                f"cluster {cluster.name!r} has {cluster.channels} alone; set "
                f'channel = "{cluster.channels}"'
            )
        known = channels.setdefault((slot.node, slot.frame_id), slot.channel)
        if known != slot.channel:
            raise ValueError(
                f"frame ID {slot.frame_id} of node {slot.node}: it is on channel {known} and on "
                f"channel {slot.channel} in entries of their own; write one entry with "
                'channel = "AB", or give it two frame IDs'
            )
    dynamic = [slot for slot in slots if slot.frame_id >= cluster.first_dynamic_id]
    both = next((slot for slot in dynamic if slot.channel == "AB"), None)
    alone = next((slot for slot in dynamic if slot.channel != "AB"), None)
    if both and alone:
        raise ValueError(
            f"dynamic frame ID {both.frame_id} of node {both.node} is on both channels and "
            f"{alone.frame_id} of node {alone.node} on {alone.channel} alone, so the channels "
            "would count to the first at different times; write both on AB, or each on one channel"
        )


def _check_static(slots: Sequence[MessageSlot], cluster: Cluster, frames: int) -> None:
    """Check that a node owns enough static slots in each cycle in which it owns one."""
    period = lcm(*(slot.repetition for slot in slots))
    for cycle in range(period):
        owned: dict[int, int] = defaultdict(int)
        for slot in slots:
            owned[slot.node] += slot.sends(cycle)
        for node, count in sorted(owned.items()):
            if 0 < count < frames:
                raise TooLong(
                    f"node {node} owns {count} static slot{'s' * (count > 1)} in cycle {cycle}, "
                    f"but a share takes {frames} frames of {cluster.static_payload_bytes} bytes; "
                    "give it more, or send shorter shares"
                )


def _contended(slots: Sequence[MessageSlot], payloads: Sequence[int]) -> list[MessageSlot]:
    """Return the dynamic slots of each node that a share takes: the first, one after the other."""
    owned: dict[int, list[MessageSlot]] = defaultdict(list)
    for slot in sorted(slots, key=lambda one: one.frame_id):
        owned[slot.node].append(slot)
    taken: list[MessageSlot] = []
    for node, of_node in sorted(owned.items()):
        chosen = of_node[: len(payloads)]
        first = chosen[0]
        ids = list(range(first.frame_id, first.frame_id + len(payloads)))
        turns = {(slot.base_cycle, slot.repetition, slot.channel) for slot in chosen}
        if [slot.frame_id for slot in chosen] != ids or len(turns) > 1:
            raise ValueError(
                f"node {node}: a share takes {len(payloads)} dynamic frames in consecutive IDs "
                f"from {first.frame_id} on, in the same cycles and on one channel; give it these "
                "IDs"
            )
        for slot, size in zip(chosen, payloads, strict=True):
            if slot.payload_bytes < size:
                raise TooLong(
                    f"frame ID {slot.frame_id} of node {node}: payload_bytes is "
                    f"{slot.payload_bytes}, but a share needs {size}; set {size + size % 2}, or "
                    "send shorter shares"
                )
        taken += chosen
    return taken


def written_bus(
    slots: Sequence[MessageSlot],
    cluster: Cluster,
    schedule: Schedule,
    share_bytes: int,
    arbiter: Arbiter,
) -> FlexRayBus:
    """Return the bus of a written slot table, whose schedule is that of `written_schedule`.

    Raises:
        ValueError: the table does not hold the shares, or gives a node to a station.
    """
    nodes = schedule.nodes
    static: tuple[int, ...] = ()
    dynamic: tuple[int, ...] = ()
    if any(schedule.static_table):
        static = payload_lengths(share_bytes, cluster.static_payload_bytes)
    if any(schedule.contender_table):
        dynamic = payload_lengths(share_bytes, cluster.dynamic_payload_bytes)
    table = written_table(slots, cluster, nodes, static, dynamic)
    for request in table.requests().values():
        check_reachable(request, cluster)
    others = other_stations(slots, cluster, nodes)
    return FlexRayBus(schedule, cluster, table, arbiter, ONE_CLASS, others)
