"""The slots that one node's share takes in one cycle, looked up fast."""

from collections import defaultdict
from math import lcm
from typing import NamedTuple

from concord.bus.flexray.channels.plan import STARTUP_NODES
from concord.bus.flexray.clock_constraints import MOST_SYNC_NODES
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.frame import Channel
from concord.bus.flexray.slot_table import SlotAssignment, SlotTable

_LEAST_SYNC_NODES = 2


class SyncNode(NamedTuple):
    """A node that sends sync frames in its key slot; `starts`: its frames are startup frames."""

    node: int
    key_slot: int
    starts: bool


class Slot(NamedTuple):
    """One frame: its ID and payload length in bytes.

    A `fixed` one is padded to that length, as every static frame of a cluster is; another is as
    short as what it carries. A key slot carries a sync frame, which may be a startup frame too.
    Without a `channel` the frame is on all channels of its bus.
    """

    frame_id: int
    payload_bytes: int
    fixed: bool = True
    sync: bool = False
    startup: bool = False
    channel: str = ""

    @property
    def checksum_channel(self) -> Channel:
        """The channel whose checksum its frames travel with."""
        return "B" if self.channel == "B" else "A"


def key_slots(table: SlotTable, cluster: Cluster) -> tuple[frozenset[int], frozenset[int]]:
    """Return the key slots of sync nodes, and of those that start the cluster.

    A node sends in its key slot in every cycle and on all channels, so only slots on these
    without cycle multiplexing can be key slots: the first of each node. A cluster that states its
    key slots has these among them; otherwise the first nodes are sync nodes, 15 at most, and three
    of them start the cluster. One node alone keeps no time with others, and a bus of turns has no
    key slots at all.
    """
    owned = sorted(_possible_key_slots(table))
    if cluster.sync_slots:
        sync = [slot for slot in owned if slot in cluster.sync_slots]
        return frozenset(sync), frozenset(sync).intersection(cluster.startup_slots)
    if len(owned) < _LEAST_SYNC_NODES:
        return frozenset(), frozenset()
    sync = owned[: cluster.sync_nodes_most or MOST_SYNC_NODES]
    return frozenset(sync), frozenset(sync[:STARTUP_NODES])


def sync_nodes_of(table: SlotTable, cluster: Cluster, nodes: int) -> tuple[SyncNode, ...]:
    """Return the sync nodes of a cluster with a network of so many nodes, by key slot.

    Key slots that the cluster states and no node of the network owns belong to other controllers,
    numbered from `nodes` on. Empty where no node of the network has a key slot.
    """
    owners = _possible_key_slots(table)
    sync, startup = key_slots(table, cluster)
    numbers = {slot: owners[slot] for slot in sync}
    if numbers:
        others = sorted(set(cluster.sync_slots) - sync)
        numbers |= {slot: nodes + place for place, slot in enumerate(others)}
    starters = startup.union(cluster.startup_slots)
    return tuple(SyncNode(numbers[slot], slot, slot in starters) for slot in sorted(numbers))


def _possible_key_slots(table: SlotTable) -> dict[int, int]:
    """The first slot that each node owns in every cycle and on all channels, with its node."""
    first: dict[int, int] = {}
    used = {letter for slot in table.assignments for letter in slot.channel}
    for slot in table.assignments:
        is_static = slot.frame_id < table.first_dynamic_id
        if is_static and slot.repetition == 1 and set(slot.channel) == used:
            first.setdefault(slot.node, slot.frame_id)
    return {frame_id: node for node, frame_id in first.items()}


class Publications:
    """A slot table seen from its nodes; it never changes."""

    def __init__(self, table: SlotTable, cluster: Cluster) -> None:
        self._static: dict[int, list[SlotAssignment]] = defaultdict(list)
        dynamic: dict[int, list[SlotAssignment]] = defaultdict(list)
        for slot in table.assignments:
            segment = self._static if slot.frame_id < table.first_dynamic_id else dynamic
            segment[slot.node].append(slot)
        self._sync, self._startup = key_slots(table, cluster)
        self._static_payload_bytes = cluster.static_payload_bytes
        self._period = lcm(*(slot.repetition for slot in table.assignments))
        # Cache of lookups; a table repeats within few cycles.
        self._known: dict[tuple[int, int], tuple[tuple[Slot, ...], ...]] = {}
        lengths = table.dynamic_payloads * table.classes
        self._dynamic: dict[int, tuple[tuple[Slot, ...], ...]] = {}
        self._turns = {node: owned[0] for node, owned in dynamic.items()}
        for node, owned in dynamic.items():
            ids = sorted(slot.frame_id for slot in owned)
            slots = [
                Slot(frame_id, length, fixed=False, channel=owned[0].channel)
                for frame_id, length in zip(ids, lengths, strict=True)
            ]
            size = len(table.dynamic_payloads)
            self._dynamic[node] = tuple(
                tuple(slots[first : first + size]) for first in range(0, len(slots), size)
            )

    def slots(self, node: int, cycle: int) -> tuple[tuple[Slot, ...], ...]:
        """The slots of one share in this cycle: its static ones, else for each urgency class those
        that it may contend for; empty for a node without slots.

        Every static frame has the cluster's static payload length.
        """
        key = (node, cycle % self._period)
        slots = self._known.get(key)
        if slots is None:
            slots = self._known[key] = self._look_up(*key)
        return slots

    def _look_up(self, node: int, cycle: int) -> tuple[tuple[Slot, ...], ...]:
        static = tuple(
            Slot(
                slot.frame_id,
                self._static_payload_bytes,
                sync=slot.frame_id in self._sync,
                startup=slot.frame_id in self._startup,
                channel=slot.channel,
            )
            for slot in self._static.get(node, ())
            if slot.sends(cycle)
        )
        if static:
            return (static,)
        # All dynamic slots of a node are in the same cycles.
        contends = node in self._turns and self._turns[node].sends(cycle)
        return self._dynamic[node] if contends else ()
