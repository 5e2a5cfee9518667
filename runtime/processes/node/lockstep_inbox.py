"""The inbox of a node in lockstep: what comes beside the message that the node waits for."""

import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence

from concord.nodes.changes import Gone, Welcome
from concord.nodes.messages import END, MalformedMessage, NodeEvent, ShareHeard, decode
from concord.nodes.node_state import NodeConfig, NodeState
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.overflow import Counter, Overflow
from concord.runtime.processes.republisher import AGAIN, is_missing

# A message that waits takes some 9 kB, however short it is: zenoh keeps what it came in.
NODE_QUEUE = 1024


def node_topics(config: NodeConfig) -> list[str]:
    """The topics that a node waits for: its heartbeat, grants, the shares of its neighbours."""
    return [f"measured/{config.index}", "grant", *(f"share/{j}" for j in config.neighbours)]


class LockstepInbox:
    """Keeps ends of nodes, repetitions and welcomes until the loop of the node takes them.

    Methods whose names begin with `_hear` run on zenoh's threads, all others on the loop's thread
    unless they say otherwise.
    """

    def __init__(self, transport: Transport, config: NodeConfig) -> None:
        self._transport, self._index = transport, config.index
        self._topics = node_topics(config)
        self._name_shares(config.neighbours)
        self._frames = config.bus.frame_format
        self.queues = Overflow(transport, self._topics, NODE_QUEUE)
        self.gone: deque[Gone] = deque()
        self.again: deque[tuple[str, bytes]] = deque(maxlen=NODE_QUEUE)
        self.welcomes: deque[Welcome] = deque(maxlen=1)
        self.refused = Counter()
        # The node has sent its last estimate.
        self.finished = False
        self._ended = self._is_environment_back = False
        self._told = threading.Condition()
        transport.listen("gone", self._hear_of_gone)
        transport.listen(f"gone/{config.index}", self._hear_of_gone)
        transport.listen(f"welcome/{config.index}", self._hear_welcome)
        transport.listen("end", self._hear_end)
        for name in ("share/*", "grant", f"measured/{config.index}"):
            transport.listen(f"{AGAIN}/{name}", self._hear_again)

    def _name_shares(self, senders: Iterable[int]) -> None:
        self._shares = {j: f"share/{j}" for j in senders}
        self._senders = {name: j for j, name in self._shares.items()}

    def follow(self, senders: Mapping[int, str | None]) -> None:
        """Hear these nodes, and no others: each listens at an endpoint, or links to this one."""
        topics = {f"share/{j}": endpoint for j, endpoint in senders.items()}
        before = self._senders
        added = {topic: topics[topic] for topic in topics if topic not in before}
        self._name_shares(senders)
        self.queues.follow(added, [topic for topic in before if topic not in topics])

    def await_one(self, name: str) -> Sequence[NodeEvent]:
        """Wait for the next message of a topic."""
        came = self.queues.receive((name,))
        return self._events(*came[0]) if came else self.taken_aside()

    def await_shares(self, senders: Sequence[int]) -> Sequence[NodeEvent]:
        """Wait for a frame of each sender; fewer come if the node is woken up."""
        assert senders, "a node in phase SHARES waits for somebody"
        came = self.queues.receive([self._shares[sender] for sender in senders])
        events: list[NodeEvent] = [
            ShareHeard(sender, frame) for sender, (_, frame) in zip(senders, came, strict=False)
        ]
        return events if len(came) == len(senders) else events + self.taken_aside()

    def next_repeated(self, state: NodeState) -> Sequence[NodeEvent]:
        """The next repetition that the node lacks, after all that came in its own time."""
        if came := self.queues.take_all():
            return [event for kept in came for event in self._events(*kept)]
        name, data = self.again.popleft()
        if name.startswith("share/") and name not in self._senders:
            return ()
        events = self._events(name, data)
        return [event for event in events if is_missing(state, event, self._frames)]

    def taken_aside(self) -> list[NodeEvent]:
        """Messages that were taken aside while the node waited for something else, as events."""
        return [event for kept in self.queues.take() for event in self._events(*kept)]

    def last_words(self, gone: Gone) -> list[NodeEvent]:
        """The end of a node, after all that it said before."""
        events = self.taken_aside()
        if gone.node in self._shares:
            topic = self._shares[gone.node]
            while (received := self._transport.receive_at_once(topic)) is not None:
                events.append(ShareHeard(gone.node, received[1]))
        return [*events, gone]

    def begin_anew(self) -> None:
        """Drop what concerned the node's former life, before it asks to be let in."""
        self.welcomes.clear()
        self.again.clear()
        self._is_environment_back = False

    def await_welcome(self) -> None:
        """Wait for a welcome, or for an environment process that is back and must hear us again."""
        with self._told:
            self._told.wait_for(lambda: self.welcomes or self._is_environment_back)
            self._is_environment_back = False

    def await_end(self) -> None:
        """Wait until the recorder says that the run is over."""
        self.queues.out = True
        with self._told:
            self._told.wait_for(lambda: self._ended)
        self.queues.close()

    def note_environment_back(self) -> None:
        """The link to the environment process is back. Runs on: a thread of zenoh's."""
        with self._told:
            self._is_environment_back = True
            self._told.notify_all()

    def wake(self, neighbour: int) -> None:
        """Interrupt a wait for the heartbeat or a neighbour's share. Runs on: any thread."""
        for topic in (f"measured/{self._index}", f"share/{neighbour}"):
            self._transport.wake(topic)

    def _hear_again(self, name: str, data: bytes) -> None:
        # The message that it repeats is in its queue by now, or was lost.
        self.again.append((name.partition("/")[2], data))

    def _hear_of_gone(self, name: str, data: bytes) -> None:
        gone: Gone | None = self._decoded(name, data)
        if gone is None:
            return
        self.gone.append(gone)
        if gone.node == self._index:
            for topic in self._topics:
                self._transport.wake(topic)
        elif gone.node in self._shares:
            self._transport.wake(self._shares[gone.node])

    def _hear_welcome(self, name: str, data: bytes) -> None:
        welcome: Welcome | None = self._decoded(name, data)
        if welcome is not None and not self.queues.out:
            # This node has not asked to be let in.
            self.refused.add()
        elif welcome is not None:
            with self._told:
                self.welcomes.append(welcome)
                self._told.notify_all()

    def _hear_end(self, _name: str, data: bytes) -> None:
        # The recorder has kept everything only after the last estimate.
        if data != END or not self.finished:
            self.refused.add()
            return
        with self._told:
            self._ended = True
            self._told.notify_all()

    def _events(self, name: str, data: bytes) -> list[NodeEvent]:
        """A message as an event; none where it cannot be decoded."""
        if name in self._senders:
            return [ShareHeard(self._senders[name], data)]
        event = self._decoded(name, data)
        return [] if event is None else [event]

    def _decoded(self, name: str, data: bytes):
        """A message, or None where the bytes are none, which is counted."""
        try:
            return decode(name, data)
        except MalformedMessage:
            self.refused.add()
            return None
