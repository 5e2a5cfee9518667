"""One queue for all that a process in real time hears, which loses what is too much."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from queue import Empty, Full, Queue

from concord.nodes.messages import END
from concord.runtime.network.zenoh_transport import Transport

_MOST = 65_536


class Mailbox:
    """Messages (topic, bytes) of some topics, in the order in which they came."""

    def __init__(self, transport: Transport, topics: Sequence[str]) -> None:
        self.ended = threading.Event()
        self._queue: Queue[tuple[str, bytes]] = Queue(_MOST)
        transport.listen("end", self._hear_end)
        for topic in topics:
            transport.listen(topic, self._hear)

    def get(self) -> tuple[str, bytes]:
        """Wait for the next message."""
        return self._queue.get()

    def get_within(self, seconds: float) -> tuple[str, bytes]:
        """Wait for the next message.

        Raises:
            Empty: none came in time.
        """
        if seconds <= 0:
            raise Empty
        return self._queue.get(timeout=seconds)

    def get_waiting(self) -> tuple[str, bytes]:
        """A message that is there already.

        Raises:
            Empty: there is none.
        """
        return self._queue.get_nowait()

    def clear(self) -> None:
        """Drop the messages that are there already."""
        with suppress(Empty):
            for _ in range(self._queue.qsize()):
                self._queue.get_nowait()

    def waiting(self) -> int:
        """The number of messages that are there already."""
        return self._queue.qsize()

    def _hear(self, name: str, data: bytes) -> None:
        """Drop the message when the mailbox is full: blocking would stall every subscription.

        Runs on: a thread of zenoh's.
        """
        with suppress(Full):
            self._queue.put_nowait((name, data))

    def _hear_end(self, name: str, data: bytes) -> None:
        """Runs on: a thread of zenoh's."""
        if data == END:
            self.ended.set()
        else:
            self._hear(name, data)
