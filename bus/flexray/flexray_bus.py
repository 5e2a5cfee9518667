"""The FlexRay bus of a network: a schedule with its slots on a cluster."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Arbiter, Fits
from concord.bus.bus import SegmentTime, Transmission
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request, walk
from concord.bus.flexray.publication import Publications
from concord.bus.flexray.relay import check_relay
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.flexray.slot_table import SlotTable, allocate
from concord.bus.flexray.slotted_bus import SlottedBus
from concord.bus.flexray.timing import (
    bus_load,
    check_timing,
    dynamic_transmissions,
    fusion_delay_us,
    segments,
    static_transmissions,
)
from concord.bus.schedule import Schedule


class FlexRayBus(SlottedBus):
    """A schedule on a cluster (`concord.bus.bus.Bus`)."""

    has_time = True

    def __init__(
        self, schedule: Schedule, cluster: Cluster, table: SlotTable, arbiter: Arbiter
    ) -> None:
        slots = Publications(table, cluster).slots
        super().__init__(schedule, slots, arbiter, cluster.number_of_cycles)
        self.cluster = cluster
        self.table = table

    @property
    def name(self) -> str:
        """The name of the cluster."""
        return self.cluster.name

    @property
    def cycle_us(self) -> float:
        """Duration of a communication cycle."""
        return self.cluster.cycle_us

    @property
    def channels(self) -> str:
        """The channels of the cluster."""
        return self.cluster.channels

    @property
    def clock_precision_us(self) -> float:
        """The smaller action point offset: both are as far from the edge of their slot as clocks
        may be apart."""
        offsets = [self.cluster.action_point_us]
        if self.cluster.minislots:
            offsets.append(self.cluster.minislot_action_point_us)
        return min(offsets)

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

    def transmissions(self, cycle: int, payload_bytes: Sequence[int]) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one."""
        static = _filled(self._owned[cycle % len(self._owned)], payload_bytes)
        winners = [
            self._requests[node]._replace(payload_bytes=size)
            for node, size in enumerate(payload_bytes)
            if size and node not in self.schedule.static_senders(cycle)
        ]
        return (*static, *dynamic_transmissions(self.cluster, winners))

    def load(self, transmissions: Sequence[Transmission]) -> float:
        """Return the fraction of a cycle in which the busier channel carries frames."""
        return max(bus_load(self.cluster, transmissions, channel) for channel in self.channels)

    def fusion_delay_us(self, rounds: int, last_cycle: Sequence[Transmission]) -> float:
        """Return the time from a measurement to the end of the last share."""
        return fusion_delay_us(self.cluster, rounds, last_cycle)

    def check_pace(self, rounds: int, time_step_s: float, stretch: float) -> None:
        """Refuse cycles that do not fit the sampling time; raise `TimingError`."""
        check_timing(self.cluster, rounds, time_step_s, stretch)

    def dynamic_room(self) -> int:
        """Return how many of the contenders that may win in a cycle fit whichever of them do."""
        wanted = min(max(self.schedule.dynamic_slot_table), len(self._requests))
        # The last IDs are the worst: every slot before them counts by empty.
        worst = list(self._requests.values())
        for count in range(wanted, 0, -1):
            if not walk(self.cluster, worst[-count:]).waiting:
                return count
        return 0

    @cached_property
    def _all_fit(self) -> bool:
        wanted = min(max(self.schedule.dynamic_slot_table), len(self._requests))
        return self.dynamic_room() == wanted

    @cached_property
    def _owned(self) -> list[tuple[Transmission, ...]]:
        return [
            static_transmissions(self.cluster, self.table.static_slots(row))
            for row in range(len(self.schedule.static_table))
        ]

    @cached_property
    def _requests(self) -> dict[int, Request]:
        """The longest request of each contender, in order of nodes."""
        contenders = sorted({node for row in self.schedule.contender_table for node in row})
        return {node: self.table.request(node) for node in contenders}

    def _fits(
        self,
        nodes: Sequence[int] | NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        payload_bytes: NDArray[np.int64],
    ) -> Fits | None:
        if self._all_fit:
            return None

        def fits(run: tuple[int, ...], places: Sequence[int]) -> bool:
            requests = [
                Request(int(nodes[i]), int(frame_ids[i]), int(payload_bytes[*run, i]))
                for i in places
            ]
            return not walk(self.cluster, requests).waiting

        return fits


def flexray_bus(
    schedule: Schedule,
    cluster: Cluster,
    share_bytes: int,
    arbiter: Arbiter,
    latch_delay_us: float = 0.0,
) -> FlexRayBus:
    """Return the bus of a schedule whose shares have at most that many bytes.

    Raises:
        ValueError: the cluster does not hold the schedule.
    """
    # A cluster fitted to a schedule without static slots has no room for a share in them.
    static: tuple[int, ...] = ()
    if any(schedule.static_table):
        static = payload_lengths(share_bytes, cluster.static_payload_bytes)
    dynamic = payload_lengths(share_bytes, cluster.dynamic_payload_bytes)
    table = allocate(schedule, cluster, static, dynamic)
    if schedule.relay:
        check_relay(schedule, cluster, table, latch_delay_us)
    return FlexRayBus(schedule, cluster, table, arbiter)


def _filled(owned: Sequence[Transmission], sizes: Sequence[int]) -> list[Transmission]:
    """Return the static frames that are sent: of each owner the first ones, up to its payload."""
    left = list(sizes)
    sent: list[Transmission] = []
    for frame in owned:
        if left[frame.node] > 0:
            left[frame.node] -= frame.payload_bytes
            sent.append(frame)
    return sent
