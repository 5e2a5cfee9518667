"""What the process of a node does: it is a loop around its state machine.

Lockstep is schedule-driven: a node always knows which message it needs next (its heartbeat, a
grant, the share of one neighbour) and waits for that one alone. Nobody coordinates, nothing is
timed. What the world does is in `nodes/world_process.py`, what the recorder does in
`nodes/recorder_process.py`.
"""

import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

from nodes import node_changes, state_machine
from nodes.absence import Absence
from nodes.changes import Gone, Joined, Welcome
from nodes.entry import await_links
from nodes.links import RECORDER, WORLD
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
    topic,
)
from nodes.node_state import NodeConfig, NodeState, Phase, count
from nodes.overflow import Overflow
from nodes.patience import Patience
from nodes.repeats import is_missing
from nodes.said import AGAIN, Said
from nodes.zenoh_transport import Transport

# A message that waits takes some 9 kB, however short it is: zenoh keeps what it came in.
NODE_QUEUE = 1024
# So long links have to come up.
_LINK_S = 5.0
# A link that was away for so long is not waited for any more, and nor is who was behind it.
_GRACE_S = 2.0
# Some steps more than others may be behind.
_KEPT = 256


def run_node(membership: Membership) -> None:
    """Be one node until the recorder says that the run is over.

    Raises:
        LinkError: the network cannot be joined.
    """
    member, config = _Member(membership), membership.config
    if not membership.late:
        member.transport.join(str(config.index), {WORLD, RECORDER, *map(str, membership.peers)})
        member.said.say(f"hello/{config.index}", membership.fingerprint.encode())
        stays = member.take_part(config, state_machine.initial_state(config))
    else:
        member.transport.join(str(config.index), {WORLD, RECORDER})
        stays = False
    while not stays:
        # It is not, or no longer, one of those who are waited for.
        stays = member.take_part(*member.rejoin())
    member.await_end()
    member.said.close()
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
        self._absence = Absence(_GRACE_S, self._miss)
        self._unreachable: deque[int] = deque()
        self._again: deque[tuple[str, bytes]] = deque(maxlen=NODE_QUEUE)
        self._welcomes: deque[Welcome] = deque(maxlen=1)
        # One for each message that was none.
        self._refused: deque[None] = deque()
        self._told = threading.Condition()
        self._finished = self._ended = self._is_world_back = False
        topics = [self._heartbeat, "grant", *self._shares.values()]
        self.transport = Transport(membership.run, membership.links, topics, NODE_QUEUE)
        self._queues = Overflow(self.transport, topics, NODE_QUEUE)
        self.transport.listen("gone", self._hear_of_gone)
        self.transport.listen(f"gone/{index}", self._hear_of_gone)
        self.transport.listen(f"welcome/{index}", self._hear_welcome)
        self.transport.listen("end", self._hear_end)
        for name in ("share/*", "grant", self._heartbeat):
            self.transport.listen(f"{AGAIN}/{name}", self._hear_again)
        self.said = Said(self.transport, f"node {index}", "estimate", _KEPT, self._in_words)
        self.said.begin()
        self.transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread."""
        if self._patience is not None:
            self._patience.see(name, is_there)
        if f"share/{name}" in self._senders:
            self._absence.see(name, is_there)
        # A hello is said again to a world that is back, not to one that is there at first.
        if self.said.see(name, is_there) and name == WORLD:
            with self._told:
                self._is_world_back = True
                self._told.notify_all()

    def _miss(self, name: str) -> None:
        """In another thread: who is out of our reach for good may not be out of the world's."""
        self._unreachable.append(int(name))
        for subscription in (self._heartbeat, self._shares[int(name)]):
            self.transport.wake(subscription)

    def _hear_again(self, name: str, data: bytes) -> None:
        """In zenoh's thread; what it repeats is in its queue by now, or was lost."""
        self._again.append((name.partition("/")[2], data))

    def _in_words(self) -> str:
        """For whom this node waits in the middle of a step."""
        kind, _, owner = self._queues.awaited.partition("/")
        if self._queues.out or kind == "measured":
            return ""
        return f"what node {owner} has to say" if kind == "share" else "a grant of the world"

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
        self.said.begin_anew()
        self._again.clear()
        while not self._welcomes:
            self._is_world_back = False
            self.transport.send(f"hello/{index}", self._membership.fingerprint.encode())
            if not begun:
                return self._beginning, state_machine.initial_state(self._beginning)
            with self._told:
                # A link to the world that was broken may have lost either word.
                self._told.wait_for(lambda: self._welcomes or self._is_world_back)
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
        if self._again:
            return self._heard_again(state)
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

    def _heard_again(self, state: NodeState) -> Sequence[NodeEvent]:
        """What has come in its time is ahead of what was said again."""
        if came := self._queues.take_all():
            return [event for kept in came for event in self._events(*kept)]
        name, data = self._again.popleft()
        if name.startswith("share/") and name not in self._senders:
            return ()
        return [event for event in self._events(name, data) if is_missing(state, event)]

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
            self.said.say(topic(message), encode(message))
