"""Messages of topics that a process does not wait for at the moment, when they are too many.

Messages of all topics come in through one thread, and a full queue blocks it. Then the message that
the process waits for cannot come in either. So the queues of a process that waits long are emptied.
"""

import threading
from collections import deque
from collections.abc import Sequence

from concord.runtime.network.zenoh_transport import Transport

# A process that has heard nothing for so long may wait for a message behind a full queue.
_LOOK_S = 0.05
# Every so many looks also what nobody waits for is taken from its queue, however busy its owner is.
_SOME_LOOKS = 20


class Overflow:
    """Takes aside what waits in queues while their owner waits for something else.

    While its owner is `out` of the network, only the latest messages of each topic are kept: nobody
    waits for it, so more of them may come than it could ever use.
    """

    def __init__(self, transport: Transport, topics: Sequence[str], queue: int) -> None:
        self.out = True
        self._transport, self._queue = transport, queue
        self._aside: dict[str, deque[tuple[str, bytes]]] = {
            topic: deque(maxlen=queue) for topic in topics
        }
        # Whether there is anything aside.
        self._keeps = False
        self._awaited, self._heard = topics[0], 0
        self._emptying = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def receive(self, topics: Sequence[str]) -> list[tuple[str, bytes]]:
        """Wait for the next message of each topic, or pattern of topics, one after the other:
        (topic, bytes). Fewer are returned if woken up, as by what was taken aside."""
        came: list[tuple[str, bytes]] = []
        for topic in topics:
            self._awaited = topic
            received = None if self._keeps else self._transport.receive(topic)
            if received is None:
                break
            self._heard += 1
            came.append(received)
        return came

    def take(self) -> list[tuple[str, bytes]]:
        """Messages that were taken aside, (topic, bytes), each topic in the order of arrival."""
        # Without the lock the thread could add to full deques, which then drop their oldest.
        with self._emptying:
            return self._taken()

    def take_all(self) -> list[tuple[str, bytes]]:
        """Return all messages received, (topic, bytes), each topic in the order of arrival."""
        with self._emptying:
            # A message that is aside came first, and its place is needed for a later one.
            taken = self._taken()
            self._fill()
            return taken + self._taken()

    def follow(self, added: dict[str, str | None], ended: Sequence[str]) -> None:
        """Receive topics that are `added`, each from the peer that listens at an endpoint or links
        to this process (`Transport.meet`), and those that `ended` no more."""
        with self._emptying:
            self._transport.unsubscribe(ended)
            for topic in ended:
                del self._aside[topic]
            for topic, endpoint in added.items():
                self._transport.meet(endpoint, [topic])
                self._aside[topic] = deque(maxlen=self._queue)

    @property
    def awaited(self) -> str:
        """The topic that its owner waits for, or has waited for last."""
        return self._awaited

    def close(self) -> None:
        """Nothing more is taken aside; before the transport is closed."""
        self._closing.set()
        self._thread.join()

    def _look(self) -> None:
        """In a thread of its own."""
        seen, looks = self._heard, 0
        while not self._closing.wait(_LOOK_S):
            seen, before = self._heard, seen
            looks += 1
            is_due = seen == before or looks % _SOME_LOOKS == 0
            if self.out or (is_due and not self._keeps):
                self._empty()
                self._transport.wake(self._awaited)

    def _empty(self) -> None:
        with self._emptying:
            self._fill()

    def _taken(self) -> list[tuple[str, bytes]]:
        """Return what is aside. Holds: the lock."""
        self._keeps = False
        return [kept.popleft() for kept in self._aside.values() for _ in range(len(kept))]

    def _fill(self) -> None:
        """Take aside what waits in the queues. Holds: the lock."""
        for topic, kept in self._aside.items():
            # Never more than fits at once, however fast it comes.
            for _ in range(self._queue):
                received = self._transport.receive_at_once(topic)
                if received is None:
                    break
                kept.append(received)
                self._keeps = True


class Counter:
    """A number that any thread may add to. Holds: its own lock, for one addition."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = 0

    @property
    def number(self) -> int:
        """The count so far."""
        return self._number

    def add(self) -> int:
        """Add one; returns the count before."""
        with self._lock:
            self._number += 1
            return self._number - 1

    def take(self) -> int:
        """Return the count, and begin again at 0."""
        with self._lock:
            taken, self._number = self._number, 0
            return taken
