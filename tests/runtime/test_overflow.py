"""The overflow keeps every message of a node that takes part, each topic in order."""

from collections import deque
from typing import cast

import pytest

from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes import overflow
from concord.runtime.processes.overflow import Overflow

QUEUE = 4


class Full:
    """A transport whose queue is filled again as soon as it is emptied."""

    def __init__(self) -> None:
        self.queue: deque[int] = deque()
        self.last = -1

    def come(self) -> None:
        """Fill the queue."""
        while len(self.queue) < QUEUE:
            self.last += 1
            self.queue.append(self.last)

    def receive_at_once(self, topic: str) -> tuple[str, bytes] | None:
        return (topic, str(self.queue.popleft()).encode()) if self.queue else None


def test_no_message_is_lost_where_the_thread_has_just_filled_the_overflow(
    monkeypatch: pytest.MonkeyPatch,
):
    # The test empties the queue itself, when the thread would.
    monkeypatch.setattr(overflow, "_LOOK_S", 3600.0)
    transport = Full()
    kept = Overflow(cast(Transport, transport), ["many"], QUEUE)
    kept.out = False
    taken = []
    for _ in range(3):
        transport.come()
        kept._empty()
        transport.come()
        taken += kept.take_all()
    kept.close()
    taken += kept.take()
    taken += [("many", str(number).encode()) for number in transport.queue]
    assert [int(data) for _, data in taken] == list(range(transport.last + 1))
