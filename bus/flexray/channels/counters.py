"""Slot counters of the dynamic segment: one for all channels of a network, or one for each."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from concord.bus.bus import Transmission
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import (
    MessageSlot,
    Request,
    frame_payloads,
    requests_of,
    walk,
)
from concord.bus.flexray.slot_table import SlotTable
from concord.bus.flexray.timing import dynamic_transmissions


class SlotCounters:
    """Slot counters of a network whose contenders have these slots, beside other stations.

    A counter on both channels also counts the frames that other stations send on one alone.
    """

    def __init__(self, table: SlotTable, cluster: Cluster, others: Sequence[MessageSlot]) -> None:
        self._cluster = cluster
        self._others = others
        self._channel_of = {
            slot.node: slot.channel
            for slot in table.assignments
            if slot.frame_id >= table.first_dynamic_id
        }
        self._channels = sorted(set(self._channel_of.values()))
        self._latest = dict(table.latest)

    def all_sent(self, requests: Sequence[Request]) -> bool:
        """Return whether these requests of nodes are sent while every other station sends."""
        for _, own, beside in self._counted(requests, self._others):
            waiting = walk(self._cluster, [*own, *requests_of(beside, self._cluster)]).waiting
            if any(request.node in self._channel_of for request in waiting):
                return False
        return True

    def frames_of(self, request: Request) -> int:
        """Return how many frames a request takes."""
        return len(frame_payloads(self._cluster, request.payload_bytes))

    def frames_sent(self, requests: Sequence[Request]) -> Counter[int]:
        """Return how many frames of each node are sent, frame by frame, while every other station
        sends."""
        sent: Counter[int] = Counter()
        for _, own, beside in self._counted(requests, self._others):
            asked = [*own, *requests_of(beside, self._cluster)]
            placed = walk(self._cluster, asked, frame_by_frame=True).placed
            sent.update(frame.node for frame in placed if frame.node in self._channel_of)
        return sent

    def most_fit(self, requests: Sequence[Request], most: int) -> int:
        """Return how many requests, at most `most`, fit whichever they are; the last IDs of each
        counter are the worst, as every slot before them counts by empty. Where controllers differ
        in pLatestTx, the last ID of any choice may be the one that is too late."""
        counted = [own for _, own, _ in self._counted(requests, ())]
        for count in range(most, 0, -1):
            runs = [own[-count:] for own in counted]
            if self._latest:
                runs += [own[max(0, k - count) : k] for own in counted for k in range(len(own))]
            if all(map(self.all_sent, runs)):
                return count
        return 0

    def transmissions(
        self, requests: Sequence[Request], due: Sequence[MessageSlot]
    ) -> tuple[Transmission, ...]:
        """Return the frames of the nodes' requests beside those that other stations have due."""
        found: list[Transmission] = []
        for channel, own, beside in self._counted(requests, due):
            asked = [*own, *requests_of(beside, self._cluster)]
            frames = dynamic_transmissions(self._cluster, asked, channel)
            found += [frame for frame in frames if frame.node in self._channel_of]
        return tuple(found)

    def ranks(self, nodes: NDArray[np.int64], frame_ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the order of frame IDs (..., C) of nodes (C,): equal ones go by channel."""
        if len(self._channels) == 1:
            return frame_ids
        places = [self._channels.index(self._channel_of[node]) for node in nodes.tolist()]
        return frame_ids * len(self._channels) + np.array(places, dtype=np.int64)

    def _counted(
        self, requests: Sequence[Request], others: Sequence[MessageSlot]
    ) -> Iterator[tuple[str, list[Request], list[MessageSlot]]]:
        """Yield the channel of each counter, the nodes' requests and the other frames on it."""
        for channel in self._channels:
            own = [
                one._replace(latest=self._latest.get(one.node))
                for one in requests
                if self._channel_of[one.node] == channel
            ]
            yield channel, own, [one for one in others if set(one.channel) & set(channel)]
