"""What has come on topics that a process does not wait for at the moment, when that is too much.

Messages of all topics come in through one thread, and a queue that is full stands in its way:
then nothing else comes in either, be it what is waited for. So whoever waits long has its queues
emptied.
"""

import threading
from collections import deque
from collections.abc import Sequence

from nodes.zenoh_transport import Transport

# Whoever waits as long as this may wait for what stands behind a full queue.
_LOOK_S = 0.05


class Overflow:
    """Takes aside what waits in queues while their owner waits for something else.

    While its owner is `out` of the network, only the latest messages of each topic are kept: nobody
    waits for it, so more of them may come than it could ever use.
    """

    def __init__(self, transport: Transport, topics: Sequence[str], queue: int) -> None:
        self.out = True
        self._transport, self._queue = transport, queue
        self._aside: dict[str, deque[bytes]] = {topic: deque(maxlen=queue) for topic in topics}
        self._awaited, self._waits = topics[0], 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def receive(self, topic: str) -> bytes | None:
        """Wait for the next message of a topic; None if woken up, as by what was taken aside."""
        self._awaited = topic
        self._waits += 1
        if any(self._aside.values()):
            return None
        received = self._transport.receive(topic)
        return None if received is None else received[1]

    def take(self) -> list[tuple[str, bytes]]:
        """What was taken aside, (topic, bytes), each topic in the order in which it came."""
        return [
            (topic, kept.popleft()) for topic, kept in self._aside.items() for _ in range(len(kept))
        ]

    def close(self) -> None:
        """Nothing more is taken aside; before the transport is closed."""
        self._closing.set()
        self._thread.join()

    def _look(self) -> None:
        """In a thread of its own."""
        seen = self._waits
        while not self._closing.wait(_LOOK_S):
            seen, before = self._waits, seen
            if self.out or (seen == before and not any(self._aside.values())):
                self._empty()
                self._transport.wake(self._awaited)

    def _empty(self) -> None:
        for topic, kept in self._aside.items():
            # Never more than fits at once, however fast it comes.
            for _ in range(self._queue):
                received = self._transport.receive_at_once(topic)
                if received is None:
                    break
                kept.append(received[1])
