"""Shares of several frames that the dynamic segment may cut.

A host that leaves its request alone has written all frames of its share into message buffers. The
controller sends each frame in its own slot, up to pLatestTx. In the next cycle the host writes a
newer share into the buffers, so frames that were left of the old one are never sent.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.flexray.channels.counters import SlotCounters
from concord.bus.flexray.dynamic_segment import Request


class SentFrames(NamedTuple):
    """Frames of the shares of contenders in one cycle: how many are `sent`, and how many a share
    has; both (..., C), 0 of a contender that does not ask."""

    sent: NDArray[np.int64]
    due: NDArray[np.int64]

    def fits(self, run: tuple[int, ...], places: Sequence[int]) -> bool:
        """Return whether the share of the last one of these contenders is sent whole."""
        return bool(self.sent[run][places[-1]] == self.due[run][places[-1]])

    @property
    def cut(self) -> NDArray[np.int64]:
        """The frames (..., C) of shares that are not sent whole."""
        return np.where(self.sent < self.due, self.sent, 0)


def sent_frames(
    counters: SlotCounters,
    nodes: NDArray[np.int64],
    frame_ids: NDArray[np.int64],
    asks: NDArray[np.bool_],
    payload_bytes: NDArray[np.int64],
) -> SentFrames:
    """Return the frames that are sent where all hosts leave their requests alone.

    Args:
        counters: slot counters of the dynamic segment.
        nodes: (C,), the contenders.
        frame_ids: (..., C), of the first frame of each share.
        asks: (..., C), whether a contender asks.
        payload_bytes: (..., C), of all frames of a share together.
    """
    owners = nodes.tolist()
    sent, due = np.zeros(asks.shape, dtype=np.int64), np.zeros(asks.shape, dtype=np.int64)
    for run in np.ndindex(asks.shape[:-1]):
        requests = {
            place: Request(
                owners[place], int(frame_ids[run][place]), int(payload_bytes[run][place])
            )
            for place in np.flatnonzero(asks[run]).tolist()
        }
        counts = counters.frames_sent(list(requests.values()))
        for place, request in requests.items():
            sent[run][place] = counts[request.node]
            due[run][place] = counters.frames_of(request)
    return SentFrames(sent, due)
