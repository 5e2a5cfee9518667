"""What the processes of nodes and of the recorder do: each is a loop around its state machine.

Lockstep is schedule-driven: a node always knows which message it needs next (its heartbeat, a
grant, the share of one neighbour) and waits for that one alone. Nobody coordinates, nothing is
timed. What the world does is in `nodes/world_process.py`.
"""

import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import msgspec

from nodes import node_changes, state_machine
from nodes.bounds import UNREADABLE, node_of
from nodes.changes import Event, Gone, Joined, Left, Welcome
from nodes.entry import await_links
from nodes.links import RECORDER, WATCH, WORLD, Links
from nodes.membership import Membership
from nodes.messages import (
    END,
    MalformedMessage,
    NodeEvent,
    NodeMessage,
    ShareHeard,
    Unreachable,
    decode,
    encode,
    is_topic,
    topic,
)
from nodes.node_state import NodeConfig, NodeState, Phase, count
from nodes.overflow import Overflow
from nodes.patience import Patience
from nodes.recording import Recorder
from nodes.watchers import Watchers
from nodes.whole_steps import WholeSteps
from nodes.zenoh_transport import Transport

# A message that waits takes some 9 kB, however short it is: zenoh keeps what it came in.
NODE_QUEUE, RECORDER_QUEUE = 1024, 8192
# So long links have to come up.
_LINK_S = 5.0
# What is said on topics that are nobody's is kept under this name.
STRANGE = "strange"
# Through a router the recorder hears itself, too.
_UNRECORDED = ("hello", "recorded", "start", "end", WATCH)


def run_node(membership: Membership) -> None:
    """Be one node until the recorder says that the run is over.

    Raises:
        LinkError: the network cannot be joined.
    """
    member, config = _Member(membership), membership.config
    if not membership.late:
        member.transport.join(str(config.index), {WORLD, RECORDER, *map(str, membership.peers)})
        member.transport.send(f"hello/{config.index}", membership.fingerprint.encode())
        stays = member.take_part(config, state_machine.initial_state(config))
    else:
        member.transport.join(str(config.index), {WORLD, RECORDER})
        stays = False
    while not stays:
        # It is not, or no longer, one of those who are waited for.
        stays = member.take_part(*member.rejoin())
    member.await_end()
    member.transport.close()


class _Member:
    """A node that others wait for."""

    def __init__(self, membership: Membership) -> None:
        config = membership.config
        index = config.index
        self._membership, self._beginning = membership, config
        self._patience = (
            None if membership.patience_s is None else Patience(WORLD, membership.patience_s)
        )
        self._heartbeat = f"measured/{index}"
        self._shares = {j: f"share/{j}" for j in config.neighbours}
        self._senders = {name: j for j, name in self._shares.items()}
        self._gone: deque[Gone] = deque()
        self._unreachable: deque[int] = deque()
        self._welcomes: deque[Welcome] = deque(maxlen=1)
        # One for each message that was none.
        self._refused: deque[None] = deque()
        self._told = threading.Condition()
        self._finished = self._ended = False
        topics = [self._heartbeat, "grant", *self._shares.values()]
        self.transport = Transport(membership.run, membership.links, topics, NODE_QUEUE)
        self._queues = Overflow(self.transport, topics, NODE_QUEUE)
        self.transport.listen("gone", self._hear_of_gone)
        self.transport.listen(f"gone/{index}", self._hear_of_gone)
        self.transport.listen(f"welcome/{index}", self._hear_welcome)
        self.transport.listen("end", self._hear_end)
        self.transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread: who is out of our reach may not be out of the world's."""
        if self._patience is not None:
            self._patience.see(name, is_there)
        neighbour = self._senders.get(f"share/{name}")
        if not is_there and neighbour is not None:
            self._unreachable.append(neighbour)
            for subscription in (self._heartbeat, self._shares[neighbour]):
                self.transport.wake(subscription)

    def _hear_of_gone(self, name: str, data: bytes) -> None:
        """In zenoh's thread: whoever waits for that node must wait no longer."""
        gone: Gone | None = self._decoded(name, data)
        if gone is None:
            return
        self._gone.append(gone)
        if gone.node == self._beginning.index:
            for subscription in (self._heartbeat, "grant", *self._shares.values()):
                self.transport.wake(subscription)
        elif gone.node in self._shares:
            self.transport.wake(self._shares[gone.node])

    def _hear_welcome(self, name: str, data: bytes) -> None:
        """In zenoh's thread."""
        welcome: Welcome | None = self._decoded(name, data)
        if welcome is not None and not self._queues.out:
            # Nobody has asked to be let in.
            self._refused.append(None)
        elif welcome is not None:
            with self._told:
                self._welcomes.append(welcome)
                self._told.notify_all()

    def _hear_end(self, _name: str, data: bytes) -> None:
        """In zenoh's thread."""
        # Nobody has kept everything before everything was said.
        if data != END or not self._finished:
            self._refused.append(None)
            return
        with self._told:
            self._ended = True
            self._told.notify_all()

    def await_end(self) -> None:
        """Until the recorder says that the run is over."""
        self._queues.out = True
        with self._told:
            self._told.wait_for(lambda: self._ended)
        self._queues.close()

    def rejoin(self) -> tuple[NodeConfig, NodeState]:
        """Ask to be let in, and wait until it is so."""
        index = self._beginning.index
        self._queues.out = True
        begun = await_links(self.transport, self._membership.peers)
        self._welcomes.clear()
        self._unreachable.clear()
        self.transport.send(f"hello/{index}", self._membership.fingerprint.encode())
        if not begun:
            return self._beginning, state_machine.initial_state(self._beginning)
        with self._told:
            self._told.wait_for(lambda: len(self._welcomes) > 0)
            welcome = self._welcomes.pop()
        # Whatever was said of this node's end was said of its former life.
        self._gone.clear()
        return node_changes.begin_late(self._beginning, welcome)

    def take_part(self, config: NodeConfig, state: NodeState) -> bool:
        """Go on to the last step; False if the others have given this node up meanwhile."""
        self._queues.out = False
        while state.phase is not Phase.FINISHED:
            events = self._next_events(config, state)
            # An end that was told before what we have just heard comes before it.
            while self._gone:
                gone = self._gone.popleft()
                if gone.node == config.index:
                    return False
                events = [*self._last_words(gone), *events]
            while self._refused:
                self._refused.popleft()
                state = count(state, "rejected message")
            state, messages = state_machine.step(config, state, *events)
            self._finished = state.phase is Phase.FINISHED
            self._send(messages)
            if state.phase is Phase.CHANGE:
                self._await_joined(state)
                config, state, messages = node_changes.apply(config, state)
                self._send(messages)
        return True

    def _next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """What the node waits for; what else has come, or nothing, if it was woken up."""
        if self._gone:
            return ()
        while self._unreachable:
            lost = Unreachable(config.index, self._unreachable.popleft())
            self.transport.send(topic(lost), encode(lost))
        match state.phase:
            case Phase.MEASUREMENT:
                return self._await_one(self._heartbeat)
            case Phase.GRANT:
                return self._await_one("grant")
            case _:
                return self._await_shares(state_machine.awaited_neighbours(config, state))

    def _await_one(self, name: str) -> Sequence[NodeEvent]:
        came = self._queues.receive((name,))
        return self._events(*came[0]) if came else self._taken_aside()

    def _await_shares(self, senders: Sequence[int]) -> Sequence[NodeEvent]:
        """A frame of each, or of as many as came before the node was woken up."""
        assert senders, "a node in phase SHARES waits for somebody"
        came = self._queues.receive([self._shares[sender] for sender in senders])
        events: list[NodeEvent] = [
            ShareHeard(sender, frame) for sender, (_, frame) in zip(senders, came, strict=False)
        ]
        return events if len(came) == len(senders) else events + self._taken_aside()

    def _taken_aside(self) -> list[NodeEvent]:
        return [event for kept in self._queues.take() for event in self._events(*kept)]

    def _events(self, name: str, data: bytes) -> list[NodeEvent]:
        """A message as an event; none where it is no message."""
        if name in self._senders:
            return [ShareHeard(self._senders[name], data)]
        event = self._decoded(name, data)
        return [] if event is None else [event]

    def _decoded(self, name: str, data: bytes) -> Any:
        """A message, or None where the bytes are none, which is counted."""
        try:
            return decode(name, data)
        except MalformedMessage:
            self._refused.append(None)
            return None

    def _last_words(self, gone: Gone) -> list[NodeEvent]:
        """A node's end, after all that it said before."""
        events = self._taken_aside()
        if gone.node in self._shares:
            while (received := self.transport.receive_at_once(self._shares[gone.node])) is not None:
                events.append(ShareHeard(gone.node, received[1]))
        return [*events, gone]

    def _await_joined(self, state: NodeState) -> None:
        """Whoever joins must hear what is said to it from the first word on."""
        changes = state.inbox.measured[state.step + 1].changes
        joined = {change.node for change in changes if isinstance(change, Joined)}
        self.transport.await_present(
            {str(j) for j in joined & set(self._membership.peers)}, _LINK_S
        )

    def _send(self, messages: Sequence[NodeMessage]) -> None:
        for message in messages:
            self.transport.send(topic(message), encode(message))


class Finished(msgspec.Struct, frozen=True):
    """World to recorder: nothing more will come but the last estimates of these nodes."""

    step: int
    members: list[int]


class _Estimated(msgspec.Struct):
    step: int


_estimated = msgspec.json.Decoder(_Estimated)


def run_recorder(
    run: str, links: Links, watch: Links, recorder: Recorder, steps: WholeSteps
) -> None:
    """Record every message until the world has finished and all last estimates have come.

    What was recorded can be heard on `watch`, message by message and in whole `steps`.

    Raises:
        LinkError: the network cannot be joined.
    """
    transport = Transport(run, links, ["**"], RECORDER_QUEUE)
    watchers = Watchers(Transport(run, watch, [], 1), steps, lambda: transport.wake("**"))
    transport.join(RECORDER, set())
    ends = _Ends(transport, steps.nodes)
    finished: Finished | None = None
    latest: dict[int, int] = {}
    leaving: dict[int, int] = {}
    topics: set[str] = set()
    while finished is None or not _complete(finished, latest, ends.silent):
        received, is_woken = transport.receive_all("**")
        kept = list(_to_be_kept(received, steps.nodes, topics))
        recorder.record(kept)
        watchers.tell(kept)
        # Kept as it came is also what somebody says who obeys no rule; it changes nothing here.
        for name, data in kept:
            with suppress(*UNREADABLE, MalformedMessage):
                if name.startswith("estimate/"):
                    latest[int(name.partition("/")[2])] = _estimated.decode(data).step
                elif name == "event":
                    leaving |= _leaving(decode(name, data))
        for name, data in received:
            finished = _finished(name, data) or finished
        for out in [i for i, step in leaving.items() if step < 0 or latest.get(i) == step]:
            # Who leaves on command may end now: nothing that it has said will be lost.
            transport.send(f"recorded/{out}", b"{}")
            del leaving[out]
        if is_woken:
            ends.look()
            watchers.look()
    recorder.close()
    transport.send("end", END)
    watchers.close()
    transport.close()


def _to_be_kept(
    received: Sequence[tuple[str, bytes]], nodes: int, topics: set[str]
) -> Iterator[tuple[str, bytes]]:
    """Those of messages (topic, bytes) that are recorded, under the names that they have there;
    `topics` are names that were looked at before, and are added to."""
    for name, data in received:
        if name not in topics:
            if name.partition("/")[0] in _UNRECORDED or _finished(name, data):
                continue
            # Of names there is no end; of channels in a file there is.
            if not is_topic(name, nodes):
                yield STRANGE, data
                continue
            topics.add(name)
        yield name, data


def _finished(name: str, data: bytes) -> Finished | None:
    """What the world says at the end; None where a message is anything else."""
    if name == "finished":
        with suppress(*UNREADABLE):
            return msgspec.json.decode(data, type=Finished)
    return None


class _Ends:
    """Nodes whose last word has come, as they are gone."""

    def __init__(self, transport: Transport, nodes: int) -> None:
        self._nodes = nodes
        self.silent: set[int] = set()
        self._transport = transport
        self._seen: deque[tuple[int, bool]] = deque()
        transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread; what the node said before is ahead of our call in the queue."""
        node = node_of(name, self._nodes)
        if node is not None:
            self._seen.append((node, is_there))
            self._transport.wake("**")

    def look(self) -> None:
        """All that came before a call has been heard."""
        while self._seen:
            node, is_there = self._seen.popleft()
            (self.silent.discard if is_there else self.silent.add)(node)


def _leaving(event: Event) -> dict[int, int]:
    """Who leaves on command, and the last step that it has estimated."""
    return {event.change.node: event.step - 1} if isinstance(event.change, Left) else {}


def _complete(finished: Finished, latest: dict[int, int], silent: set[int]) -> bool:
    """Whether the last estimate of every node has come that may still say something."""
    members = (node for node in finished.members if node not in silent)
    return all(latest.get(node) == finished.step for node in members)
