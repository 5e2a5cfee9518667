"""Random traffic of a slot table, counted slot by slot as controllers do.

Requests come at random, at least a period apart and mostly as close as that; those with an offset
come at their times. A message buffer holds the newest value, so the response is that of the oldest
request of a transmission. Where a node has frames of several urgency classes, each of its requests
has one of these, drawn at random, and replaces one that waits in another class.
"""

from collections.abc import Sequence
from math import ceil, inf

import numpy as np

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.features.flexray_tools.response_times import is_alternative, last_minislot

_LATE_CHANCE, _LATE_PERIODS = 0.3, 0.3


def worst_responses(
    cluster: Cluster, slots: Sequence[MessageSlot], cycles: int, random: np.random.Generator
) -> tuple[float | None, ...]:
    """Return the longest time from a request to the last bit of its frame, in microseconds.

    A frame on both channels counts when it has arrived on the later one. None: never sent.
    """
    requests = [_requests(cluster, slot, cycles, random) for slot in slots]
    _draw_classes(cluster, slots, requests, random)
    worst = [-inf] * len(slots)
    for channel in cluster.channels:
        of_channel = [i for i, slot in enumerate(slots) if channel in slot.channel]
        order = sorted(of_channel, key=lambda i: (slots[i].frame_id, slots[i].base_cycle))
        seen = _Channel(cluster, [slots[i] for i in order], [requests[i] for i in order])
        for place, response_us in zip(order, seen.run(cycles), strict=True):
            worst[place] = max(worst[place], response_us)
    return tuple(None if response_us < 0 else float(response_us) for response_us in worst)


def _requests(
    cluster: Cluster, slot: MessageSlot, cycles: int, random: np.random.Generator
) -> np.ndarray:
    """Times of requests over so many cycles, and one beyond them."""
    period_us = slot.period_us or slot.repetition * cluster.cycle_us
    count = ceil(cycles * cluster.cycle_us / period_us) + 1
    if slot.offset_us is not None:
        return np.append(slot.offset_us + period_us * np.arange(count), inf)
    late = random.exponential(_LATE_PERIODS, count) * (random.random(count) < _LATE_CHANCE)
    return np.append(np.cumsum(period_us * (1 + late)) - random.uniform(0, period_us), inf)


def _draw_classes(
    cluster: Cluster,
    slots: Sequence[MessageSlot],
    requests: list[np.ndarray],
    random: np.random.Generator,
) -> None:
    """Give the requests of each node with several urgency classes to one class each."""
    of_node: dict[int, list[int]] = {}
    for place, slot in enumerate(slots):
        if slot.frame_id >= cluster.first_dynamic_id:
            of_node.setdefault(slot.node, []).append(place)
    for places in of_node.values():
        classes = sorted({slots[place].urgency_class for place in places})
        if len(classes) == 1:
            continue
        times = requests[places[0]][:-1]
        drawn = random.choice(classes, len(times))
        for place in places:
            own = times[drawn == slots[place].urgency_class]
            requests[place] = np.append(own, inf)


class _Channel:
    """The controllers on one channel: `slots` in order, and the times of their requests."""

    def __init__(
        self, cluster: Cluster, slots: Sequence[MessageSlot], requests: Sequence[np.ndarray]
    ) -> None:
        self._cluster = cluster
        self._slots = slots
        self._requests = requests
        self._served = [0] * len(slots)
        self._worst = [-inf] * len(slots)
        self._others = [
            [
                j
                for j, other in enumerate(slots)
                if other.frame_id >= cluster.first_dynamic_id and is_alternative(other, slot)
            ]
            if slot.frame_id >= cluster.first_dynamic_id
            else []
            for slot in slots
        ]
        self._sent: dict[int, int] = {}
        self._last = [last_minislot(slot, cluster) for slot in slots]
        self._lengths = [cluster.dynamic_slot_minislots(slot.payload_bytes) for slot in slots]

    def run(self, cycles: int) -> list[float]:
        """Return the longest response of each slot; -inf for one that was never sent."""
        cluster = self._cluster
        period = cluster.number_of_cycles
        rows = [
            [i for i, slot in enumerate(self._slots) if slot.sends(cycle)]
            for cycle in range(period)
        ]
        for cycle in range(cycles):
            start_us = cycle * cluster.cycle_us
            minislot, counted = 1, cluster.first_dynamic_id
            self._sent.clear()
            for place in rows[cycle % period]:
                frame_id = self._slots[place].frame_id
                if frame_id < cluster.first_dynamic_id:
                    self._send_static(place, start_us + cluster.slot_start_us(frame_id))
                    continue
                minislot += frame_id - counted
                counted = frame_id + 1
                minislot += self._dynamic_minislots(place, start_us, minislot)
        return self._worst

    def _send_static(self, place: int, slot_us: float) -> None:
        cluster = self._cluster
        frame_us = cluster.frame_us(cluster.static_payload_bytes)
        self._send(place, slot_us, slot_us + cluster.action_point_us + frame_us)

    def _dynamic_minislots(self, place: int, start_us: float, minislot: int) -> int:
        """Send what is pending in a dynamic slot, and return how long the slot is."""
        cluster, length = self._cluster, self._lengths[place]
        if minislot > self._last[place]:
            return 1
        slot_us = start_us + cluster.minislot_start_us(minislot)
        frame_us = cluster.frame_us(self._slots[place].payload_bytes)
        end_us = slot_us + cluster.minislot_action_point_us + frame_us
        return length if self._send(place, slot_us, end_us) else 1

    def _send(self, place: int, slot_us: float, end_us: float) -> bool:
        """Send all requests that came by the beginning of a slot; say whether there were some."""
        if self._others[place]:
            self._replace(place, slot_us)
        requests, first = self._requests[place], self._served[place]
        slot = self._slots[place]
        sent = self._sent.get(slot.node, slot.urgency_class)
        if requests[first] > slot_us or (self._others[place] and sent != slot.urgency_class):
            return False
        if self._others[place]:
            self._sent[slot.node] = slot.urgency_class
        self._worst[place] = max(self._worst[place], end_us - requests[first])
        while requests[self._served[place]] <= slot_us:
            self._served[place] += 1
        return True

    def _replace(self, place: int, slot_us: float) -> None:
        """Leave out requests before the newest one of the node in another class."""
        newest = -inf
        for other in self._others[place]:
            requests = self._requests[other]
            count = int(np.searchsorted(requests, slot_us, side="right"))
            newest = max(newest, requests[count - 1] if count else -inf)
        while self._requests[place][self._served[place]] <= newest:
            self._served[place] += 1
