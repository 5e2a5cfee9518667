"""The FlexRay bus of a network: a schedule with its slots on a cluster."""

from collections.abc import Callable, Container, Iterator, Sequence
from functools import cached_property
from itertools import zip_longest
from math import nan

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import ONE_CLASS, Arbiter, Fits, UrgencyClasses
from concord.bus.bus import SegmentTime, Transmission
from concord.bus.clocks import ClockDrift, ClockErrors, SyncOutage
from concord.bus.flexray.channels.counters import SlotCounters
from concord.bus.flexray.channels.plan import ChannelPlan
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cut_shares import SentFrames, sent_frames
from concord.bus.flexray.dynamic_segment import MessageSlot, Request
from concord.bus.flexray.publication import Publications, SyncNode, sync_nodes_of
from concord.bus.flexray.share_frames import null_frame, payload_lengths
from concord.bus.flexray.slot_table import SlotTable, allocate
from concord.bus.flexray.slotted_bus import SlottedBus
from concord.bus.flexray.timing import (
    bus_load,
    check_relay,
    check_timing,
    fusion_delay_us,
    segments,
    static_transmissions,
)
from concord.bus.schedule import Schedule


class FlexRayBus(SlottedBus):
    """A schedule on a cluster (`concord.bus.bus.Bus`).

    Stations that are no nodes send in each of their cycles, in the slots `others`. Their dynamic
    frames delay those of the nodes; no figure of the network counts them.
    """

    has_time = sync_in_frames = True
    # A bound needs the periods of all frames, which a bus does not know.
    worst_access_us = nan

    def __init__(
        self,
        schedule: Schedule,
        cluster: Cluster,
        table: SlotTable,
        arbiter: Arbiter,
        classes: UrgencyClasses,
        others: Sequence[MessageSlot] = (),
    ) -> None:
        slots = Publications(table, cluster).slots
        super().__init__(schedule, slots, arbiter, cluster.number_of_cycles, classes)
        self.cluster = cluster
        self.cycle_us = cluster.cycle_us
        self.table = table
        self.others = tuple(others)
        self._counters = SlotCounters(table, cluster, self.others)

    @property
    def name(self) -> str:
        """The name of the cluster."""
        return self.cluster.name

    @property
    def channels(self) -> str:
        """The channels of the cluster."""
        return self.cluster.channels

    @property
    def clock_precision_us(self) -> float:
        """The smaller action point offset: clocks may be apart by it."""
        minislot = [self.cluster.minislot_action_point_us] if self.cluster.minislots else []
        return min([self.cluster.action_point_us, *minislot])

    @property
    def sync_nodes(self) -> tuple[int, ...]:
        """The nodes that send sync frames (`concord.bus.clocks.KeepsClocks`)."""
        return tuple(one.node for one in self._sync)

    def clock_errors(
        self,
        nodes: int,
        drifts: tuple[ClockDrift, ...],
        outages: tuple[SyncOutage, ...],
        cycle: int,
        key: tuple[int, int],
    ) -> ClockErrors:
        """Return the clocks of so many nodes in a cycle where some oscillators drift, and where
        the sync frames of some nodes are missing.

        Oscillators drift and clocks are corrected in all cycles, also in those between the steps.
        """
        number = self.timebase.bus_cycle
        # Only here: most networks have oscillators that do not drift.
        from concord.bus.flexray.clocks.disturbances import Disturbances
        from concord.bus.flexray.clocks.disturbed import clock_errors

        disturbed = Disturbances(drifts, outages).renumbered(number)
        return clock_errors(self.cluster, nodes, disturbed, number(cycle), self._sync)

    def segments(self) -> tuple[SegmentTime, ...]:
        """Return the segments of a cycle, in order."""
        return segments(self.cluster)

    def marks_us(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return where static slots end and where minislots begin."""
        cluster = self.cluster
        ends = [k * cluster.static_slot_us for k in range(1, cluster.static_slots)]
        return ends, [cluster.minislot_start_us(k) for k in range(1, cluster.minislots + 1)]

    def own_slot_us(self, node: int, cycle: int) -> tuple[float, float]:
        """Return the beginning and the end of the static slots of a node in a cycle."""
        row = cycle % len(self.schedule.static_table)
        owned = [slot.frame_id for slot in self.table.static_slots(row) if slot.node == node]
        end_us = self.cluster.slot_start_us(max(owned)) + self.cluster.static_slot_us
        return self.cluster.slot_start_us(min(owned)), end_us

    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one;
        those without a slot, or room in the segment, are left out."""
        static = _filled(self._owned[cycle % len(self._owned)], payload_bytes)
        own = self.schedule.static_senders(cycle)
        winners = [
            Request(node, slots[urgency_class][0].frame_id, size)
            for node, (size, urgency_class) in enumerate(
                zip_longest(payload_bytes, classes, fillvalue=0)
            )
            if size and node not in own and urgency_class < len(slots := self.slots(node, cycle))
        ]
        due = [slot for slot in self.others if slot.sends(self.timebase.bus_cycle(cycle))]
        return (*static, *self._counters.transmissions(winners, due))

    def null_frames(
        self, turn: int, bus_cycle: int, sent: Container[tuple[int, int]] = ()
    ) -> Iterator[tuple[Transmission, bytes]]:
        """Yield the null frames of cycle `bus_cycle` of the bus, in which static slots have their
        owners of cycle `turn`: one in each slot without a frame whose (node, ID) is in `sent`."""
        count = bus_cycle % self.cluster.number_of_cycles
        for frame in self._owned[turn % len(self._owned)]:
            if (frame.node, frame.frame_id) in sent:
                continue
            slots = self.slots(frame.node, turn)[0]
            slot = next(slot for slot in slots if slot.frame_id == frame.frame_id)
            yield frame, null_frame(slot, count)

    def load(self, transmissions: Sequence[Transmission]) -> float:
        """Return the fraction of a cycle in which the busier channel carries frames."""
        return max(bus_load(self.cluster, transmissions, channel) for channel in self.channels)

    @property
    def other_load(self) -> float:
        """Part of the time in which frames of other stations occupy the busier channel."""
        cluster = self.cluster
        loads = [
            sum(
                cluster.frame_us(
                    cluster.static_payload_bytes
                    if slot.frame_id < cluster.first_dynamic_id
                    else slot.payload_bytes
                )
                / slot.repetition
                for slot in self.others
                if channel in slot.channel
            )
            for channel in self.channels
        ]
        return max(loads) / cluster.cycle_us

    def fusion_delay_us(self, rounds: int, last_cycle: Sequence[Transmission]) -> float:
        """Return the time from a measurement to the end of the last share."""
        return fusion_delay_us(self.cluster, rounds, last_cycle)

    def check_pace(self, rounds: int, time_step_s: float, stretch: float) -> None:
        """Refuse cycles that do not fit the sampling time; raise `TimingError`."""
        check_timing(self.cluster, rounds, time_step_s, stretch)

    def dynamic_room(self) -> int:
        """Return how many of the longest shares fit whichever they are."""
        requests = self.table.requests(self.table.classes - 1)
        worst = [requests[node] for node in self._contenders]
        return self._counters.most_fit(worst, self._most_winners)

    @cached_property
    def _sync(self) -> tuple[SyncNode, ...]:
        return sync_nodes_of(self.table, self.cluster, self.schedule.nodes)

    @cached_property
    def _all_fit(self) -> bool:
        return self.dynamic_room() == self._most_winners

    @cached_property
    def _owned(self) -> list[tuple[Transmission, ...]]:
        return [
            static_transmissions(self.cluster, slots)
            for slots in self.table.static_rows(len(self.schedule.static_table))
        ]

    def _fits(
        self,
        nodes: NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> Fits | None:
        if self._all_fit:
            return None
        sizes, owners = payload_bytes(), nodes.tolist()

        def fits(run: tuple[int, ...], places: Sequence[int]) -> bool:
            ids, lengths = frame_ids[run], sizes[run]
            requests = [Request(owners[i], int(ids[i]), int(lengths[i])) for i in places]
            return self._counters.all_sent(requests)

        return fits

    def _sent_frames(
        self,
        nodes: NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        asks: NDArray[np.bool_],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> SentFrames | None:
        if self._all_fit or not self._arbiter.cuts:
            return None
        sizes = payload_bytes()
        return sent_frames(self._counters, nodes, frame_ids, asks, sizes)

    def _ranks(self, nodes: NDArray[np.int64], frame_ids: NDArray[np.int64]) -> NDArray[np.int64]:
        return self._counters.ranks(nodes, frame_ids)


def flexray_bus(
    schedule: Schedule,
    cluster: Cluster,
    share_bytes: int,
    arbiter: Arbiter,
    latch_delay_us: float = 0.0,
    classes: UrgencyClasses = ONE_CLASS,
    plan: ChannelPlan | None = None,
) -> FlexRayBus:
    """Return the bus of a schedule whose shares have at most that many bytes, on the channels of a
    plan; without one on all.

    Raises:
        ValueError: the cluster does not hold the schedule.
    """
    # A cluster fitted to a schedule without static slots has no room for a share in them.
    static: tuple[int, ...] = ()
    if any(schedule.static_table):
        static = payload_lengths(share_bytes, cluster.static_payload_bytes)
    dynamic = payload_lengths(share_bytes, cluster.dynamic_payload_bytes)
    table = allocate(schedule, cluster, static, dynamic, classes.count, plan)
    if schedule.relay:
        if plan and plan.is_apart:
            raise ValueError(
                "--relay: a share in a slot of one channel cannot pass on what the other channel "
                "brings at the same time; use --channels all, A or B, or leave --relay out"
            )
        check_relay(schedule, cluster, table, latch_delay_us)
    return FlexRayBus(schedule, cluster, table, arbiter, classes)


def _filled(owned: Sequence[Transmission], sizes: Sequence[int]) -> list[Transmission]:
    """Return the static frames that are sent: of each owner the first ones, up to its payload."""
    left = list(sizes)
    sent: list[Transmission] = []
    for frame in owned:
        if left[frame.node] > 0:
            left[frame.node] -= frame.payload_bytes
            sent.append(frame)
    return sent
