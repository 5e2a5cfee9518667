"""The inbox of the environment process: messages of nodes, and notices of all else."""

import re
import sys
import threading
from queue import Empty, SimpleQueue

import msgspec

from concord.nodes.bounds import node_of
from concord.nodes.commands import Answer
from concord.nodes.messages import END, MalformedMessage, Unreachable, decode
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.environment.notices import (
    Asked,
    Hello,
    Notice,
    RecorderCaughtUp,
    Repeated,
)
from concord.runtime.processes.overflow import Counter, Overflow
from concord.runtime.processes.republisher import AGAIN

ENVIRONMENT_QUEUE = 8192
TOPICS = ("bid/*", "estimate/*")
_ANSWER_S = 5.0
_FINGERPRINT = re.compile(rb"[0-9a-f]{64}")


class EnvironmentInbox:
    """Keeps what comes until the loop of the environment process takes it.

    Methods whose names begin with `_hear` run on zenoh's threads, all others on the loop's thread
    unless they say otherwise.
    """

    def __init__(self, transport: Transport, nodes: int) -> None:
        self.refused = Counter()
        self.ended = threading.Event()
        # The first step has begun; the last step is over.
        self.begun = self.finished = False
        self._transport, self._nodes = transport, nodes
        self._notices: SimpleQueue[Notice] = SimpleQueue()
        self._source = "estimate/*"
        self._queues = Overflow(transport, TOPICS, ENVIRONMENT_QUEUE)
        transport.listen("end", self._hear_end)
        transport.listen("hello/*", self._hear_hello)
        transport.listen("recorded/*", self._hear_recorded)
        transport.listen("unreachable/*", self._hear_unreachable)
        for kind in ("bid", "estimate", "hello"):
            transport.listen(f"{AGAIN}/{kind}/*", self._hear_again)

    def begin(self) -> None:
        """Take part: from now on the queues hold what the loop waits for."""
        self.begun = True
        self._queues.out = False

    def await_end(self) -> None:
        """Wait until the recorder has kept everything."""
        self._queues.out = True
        self.ended.wait()
        self._queues.close()

    def next_notice(self) -> Notice:
        """Wait for the next notice."""
        return self._notices.get()

    def receive(self, source: str) -> Notice | list[tuple[str, bytes]]:
        """Wait for the next notice, or for messages (topic, bytes) of a source; none if woken."""
        # Set before the look for notices: a notice that comes later wakes up the wait below.
        self._source = source
        if self._notices.empty():
            return self._queues.receive((source,)) or self._queues.take()
        return self._notices.get()

    def waiting(self, source: str) -> list[tuple[str, bytes]]:
        """The messages of a source that are there already, one per node at most."""
        messages = self._queues.take()
        for _ in range(self._nodes):
            received = self._transport.receive_at_once(source)
            if received is None:
                break
            messages.append(received)
        return messages

    def notify(self, notice: Notice) -> None:
        """Give the loop a notice. Runs on: any thread."""
        self._notices.put(notice)
        if not self.finished:
            self._transport.wake(self._source)

    def refuse(self, why: str) -> None:
        """Count a message that cannot be used, and show the first. Runs on: any thread."""
        # A flood of such lines would hide all others.
        if self.refused.add() == 0:
            sys.stderr.write(f"environment: {why}\n")

    def ask(self, payload: bytes) -> bytes:
        """Have the loop answer a command. Runs on: a thread of zenoh's."""
        answer: SimpleQueue[Answer] = SimpleQueue()
        self.notify(Asked(payload, answer))
        try:
            return msgspec.json.encode(answer.get(timeout=_ANSWER_S))
        except Empty:
            return msgspec.json.encode(Answer(False, "the environment does not answer; try again"))

    def _hear_again(self, name: str, data: bytes) -> None:
        topic = name.partition("/")[2]
        if topic.startswith("hello/"):
            # A later repetition would count as the hello of the node's next life.
            return None if self.begun else self._hear_hello(topic, data)
        try:
            self.notify(Repeated(decode(topic, data)))
        except MalformedMessage as error:
            self.refuse(str(error))

    def _hear_end(self, _name: str, data: bytes) -> None:
        # The recorder has kept everything only after the last step.
        if data == END and self.finished:
            self.ended.set()
        else:
            self.refuse(f"topic 'end' carried {data[:60]!r} before the end")

    def _hear_hello(self, name: str, data: bytes) -> None:
        node = node_of(name.partition("/")[2], self._nodes)
        if node is not None and _FINGERPRINT.fullmatch(data):
            self.notify(Hello(node, data.decode()))
        else:
            self.refuse(f"topic {name[:60]!r} carried {data[:60]!r}: no digest of a setup")

    def _hear_recorded(self, name: str, _data: bytes) -> None:
        node = node_of(name.partition("/")[2], self._nodes)
        if node is None:
            self.refuse(f"topic {name[:60]!r} is of no node")
        else:
            self.notify(RecorderCaughtUp(node))

    def _hear_unreachable(self, name: str, data: bytes) -> None:
        try:
            lost: Unreachable = decode(name, data)
        except MalformedMessage as error:
            self.refuse(str(error))
            return
        if max(lost.node, lost.neighbour) < self._nodes:
            self.notify(lost)
        else:
            self.refuse(f"topic {name!r} speaks of no node")
