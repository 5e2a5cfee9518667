"""What the processes of nodes and of the recorder do: each is a loop around its state machine.

Lockstep is schedule-driven: a node always knows which message it needs next (its heartbeat, a
grant, the share of one neighbour) and waits for that one alone. Nobody coordinates, nothing is
timed. What the world does is in `nodes/world_process.py`.
"""

from collections import deque
from collections.abc import Collection, Sequence
from contextlib import suppress

import msgspec

from nodes import node_changes, state_machine
from nodes.changes import Event, Gone, Joined, Left
from nodes.entry import await_links
from nodes.links import RECORDER, WATCH, WORLD, Links
from nodes.messages import (
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
from nodes.patience import Patience
from nodes.recording import Recorder
from nodes.watchers import Watchers
from nodes.whole_steps import WholeSteps
from nodes.zenoh_transport import Transport

NODE_QUEUE, RECORDER_QUEUE = 1024, 65_536
# So long links have to come up.
_LINK_S = 5.0
# Through a router the recorder hears itself, too.
_UNRECORDED = ("hello", "recorded", "start", "finished", "end", WATCH)


def run_node(
    run: str,
    links: Links,
    config: NodeConfig,
    peers: Collection[int],
    fingerprint: str,
    late: bool = False,
    patience_s: float | None = None,
) -> None:
    """Be one node until the recorder says that the run is over.

    `peers` are those whom it hears or who hear it: all must be there before the first share. A node
    that is `late` joins a network that may run already. Where nobody else does, `patience_s` ends
    the process of a node that has been without the world for so long.

    Raises:
        LinkError: the network cannot be joined.
    """
    seat = _Seat(run, links, config, peers, patience_s)
    if not late:
        seat.transport.join(str(config.index), {WORLD, RECORDER, *map(str, peers)})
        seat.transport.send(f"hello/{config.index}", fingerprint.encode())
        stays = seat.take_part(config, state_machine.initial_state(config))
    else:
        seat.transport.join(str(config.index), {WORLD, RECORDER})
        stays = False
    while not stays:
        # It is not, or no longer, one of those who are waited for.
        stays = seat.take_part(*seat.rejoin(fingerprint))
    while seat.transport.receive("end") is None:
        pass
    seat.transport.close()


class _Seat:
    """A node's place in the network of processes."""

    def __init__(
        self,
        run: str,
        links: Links,
        config: NodeConfig,
        peers: Collection[int],
        patience_s: float | None,
    ) -> None:
        index = config.index
        self._beginning = config
        self._peers = peers
        self._patience = None if patience_s is None else Patience(WORLD, patience_s)
        self._heartbeat, self._welcome = f"measured/{index}", f"welcome/{index}"
        self._shares = {j: f"share/{j}" for j in config.neighbours}
        self._gone: deque[Gone] = deque()
        self._unreachable: deque[int] = deque()
        topics = [self._heartbeat, "grant", self._welcome, "end", *self._shares.values()]
        self.transport = Transport(run, links, topics, NODE_QUEUE)
        self.transport.listen("gone", self._hear_of_end)
        self.transport.listen(f"gone/{index}", self._hear_of_end)
        self.transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread: who is out of our reach may not be out of the world's."""
        if self._patience is not None:
            self._patience.see(name, is_there)
        if not is_there and name.isdecimal() and int(name) in self._shares:
            self._unreachable.append(int(name))
            for subscription in (self._heartbeat, self._shares[int(name)]):
                self.transport.wake(subscription)

    def _hear_of_end(self, name: str, data: bytes) -> None:
        """In zenoh's thread: whoever waits for that node must wait no longer."""
        try:
            gone: Gone = decode(name, data)
        except MalformedMessage:
            return
        self._gone.append(gone)
        if gone.node == self._beginning.index:
            for subscription in (self._heartbeat, "grant", *self._shares.values()):
                self.transport.wake(subscription)
        elif gone.node in self._shares:
            self.transport.wake(self._shares[gone.node])

    def rejoin(self, fingerprint: str) -> tuple[NodeConfig, NodeState]:
        """Ask to be let in, and wait until it is so."""
        index = self._beginning.index
        begun = await_links(self.transport, self._peers)
        while self.transport.receive_at_once(self._welcome) is not None:
            pass
        self._unreachable.clear()
        self.transport.send(f"hello/{index}", fingerprint.encode())
        if not begun:
            return self._beginning, state_machine.initial_state(self._beginning)
        while (received := self.transport.receive(self._welcome)) is None:
            pass
        # Whatever was said of this node's end was said of its former life.
        self._gone.clear()
        return node_changes.begin_late(self._beginning, decode(*received))

    def take_part(self, config: NodeConfig, state: NodeState) -> bool:
        """Go on to the last step; False if the others have given this node up meanwhile."""
        while state.phase is not Phase.FINISHED:
            try:
                events = self._next_events(config, state)
            except MalformedMessage:
                state = count(state, "rejected message")
                continue
            # An end that was told before what we have just heard comes before it.
            while self._gone:
                gone = self._gone.popleft()
                if gone.node == config.index:
                    return False
                events = [*self._last_words(gone), *events]
            state, messages = state_machine.step(config, state, *events)
            self._send(messages)
            if state.phase is Phase.CHANGE:
                self._await_joined(state)
                config, state, messages = node_changes.apply(config, state)
                self._send(messages)
        return True

    def _next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """What the node waits for; nothing if it was woken up."""
        if self._gone:
            return ()
        while self._unreachable:
            lost = Unreachable(config.index, self._unreachable.popleft())
            self.transport.send(topic(lost), encode(lost))
        match state.phase:
            case Phase.MEASUREMENT:
                received = self.transport.receive(self._heartbeat)
            case Phase.GRANT:
                received = self.transport.receive("grant")
            case _:
                return self._await_shares(state_machine.awaited_neighbours(config, state))
        return () if received is None else (decode(*received),)

    def _await_shares(self, senders: Sequence[int]) -> Sequence[NodeEvent]:
        """A frame of each, or of as many as came before the node was woken up."""
        assert senders, "a node in phase SHARES waits for somebody"
        events = []
        for sender in senders:
            received = self.transport.receive(self._shares[sender])
            if received is None:
                break
            events.append(ShareHeard(sender, received[1]))
        return events

    def _last_words(self, gone: Gone) -> list[NodeEvent]:
        """A node's end, after all that it said before."""
        events: list[NodeEvent] = []
        if gone.node in self._shares:
            while (received := self.transport.receive_at_once(self._shares[gone.node])) is not None:
                events.append(ShareHeard(gone.node, received[1]))
        return [*events, gone]

    def _await_joined(self, state: NodeState) -> None:
        """Whoever joins must hear what is said to it from the first word on."""
        changes = state.inbox.measured[state.step + 1].changes
        joined = {change.node for change in changes if isinstance(change, Joined)}
        self.transport.await_present({str(j) for j in joined & set(self._peers)}, _LINK_S)

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
    ends = _Ends(transport)
    finished: Finished | None = None
    latest: dict[int, int] = {}
    leaving: dict[int, int] = {}
    while finished is None or not _complete(finished, latest, ends.silent):
        received = transport.receive("**")
        if received is None:
            ends.look()
            watchers.look()
            continue
        name, data = received
        kind, _, node = name.partition("/")
        if kind == "finished":
            with suppress(msgspec.MsgspecError):
                finished = msgspec.json.decode(data, type=Finished)
        if kind in _UNRECORDED:
            continue
        recorder.record(name, data)
        watchers.tell(name, data)
        # Kept as it came is also what somebody says who obeys no rule; it changes nothing here.
        if kind == "estimate" and node.isdecimal():
            with suppress(msgspec.MsgspecError):
                latest[int(node)] = _estimated.decode(data).step
        elif kind == "event":
            with suppress(MalformedMessage):
                leaving |= _leaving(decode(name, data))
        for out in [i for i, step in leaving.items() if step < 0 or latest.get(i) == step]:
            # Who leaves on command may end now: nothing that it has said will be lost.
            transport.send(f"recorded/{out}", b"{}")
            del leaving[out]
    recorder.close()
    transport.send("end", b"{}")
    watchers.close()
    transport.close()


class _Ends:
    """Nodes whose last word has come, as they are gone."""

    def __init__(self, transport: Transport) -> None:
        self.silent: set[int] = set()
        self._transport = transport
        self._seen: deque[tuple[int, bool]] = deque()
        transport.watch(self._see)

    def _see(self, name: str, is_there: bool) -> None:
        """In zenoh's thread; what the node said before is ahead of our call in the queue."""
        if name.isdecimal():
            self._seen.append((int(name), is_there))
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
