"""Lockstep at a node: it waits for exactly the message that it needs next.

A node always knows which message that is: its heartbeat, a grant, or the share of one neighbour. No
process coordinates the others, and no wait ends by the clock.
"""

from collections import deque
from collections.abc import Sequence

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.changes import Joined
from concord.nodes.messages import NodeEvent, NodeMessage, Unreachable, encode, topic
from concord.nodes.node_state import NodeConfig, NodeState, Phase, count
from concord.runtime.network.links import ENVIRONMENT, peers_of
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.node.lockstep_inbox import NODE_QUEUE, LockstepInbox, node_topics
from concord.runtime.processes.node.membership import Membership, await_links
from concord.runtime.processes.node.process import GivenUp
from concord.runtime.processes.peer_timeout import DepartedPeers, PeerTimeout
from concord.runtime.processes.republisher import Republisher

# Links of a node that joins come up within so long.
_LINK_S = 5.0
# A node that has been out of reach for so long is not waited for any more.
_GRACE_S = 2.0
# The republisher keeps the messages of some steps more than one process may be behind another.
_KEPT = 256


class LockstepNode:
    """Paces a node by its neighbours: no message may be lost, and all wait for each."""

    def __init__(self, membership: Membership) -> None:
        config = self._beginning = membership.config
        self._membership = membership
        self._heartbeat = f"measured/{config.index}"
        self.transport = Transport(
            membership.run, membership.links, node_topics(config), NODE_QUEUE
        )
        self._inbox = LockstepInbox(self.transport, config)
        self._neighbours, self._peers = config.neighbours, {*membership.peers}
        self._unreachable: deque[int] = deque()
        self._departed = DepartedPeers(_GRACE_S, self._miss)
        self._timeout = PeerTimeout(ENVIRONMENT, membership.peer_timeout_s)
        self._republisher = Republisher(
            self.transport, f"node {config.index}", "estimate", _KEPT, self._waits_for
        )
        self._republisher.begin()
        self.transport.watch(self._see)
        self._timeout.expect()

    def say_hello(self) -> None:
        """Tell the environment process that this node is ready."""
        hello = f"hello/{self._beginning.index}"
        self._republisher.say(hello, self._membership.fingerprint.encode())

    def configured(self, config: NodeConfig) -> NodeConfig:
        """The same."""
        return config

    def enter(self) -> tuple[NodeConfig, NodeState]:
        """Ask to be let in, and wait until the node is."""
        index, inbox = self._beginning.index, self._inbox
        inbox.queues.out = True
        begun = await_links(self.transport, self._membership.peers)
        self._unreachable.clear()
        self._republisher.begin_anew()
        inbox.begin_anew()
        while not inbox.welcomes:
            self.transport.send(f"hello/{index}", self._membership.fingerprint.encode())
            if not begun:
                return self._beginning, state_machine.initial_state(self._beginning)
            # A link to the environment process that was broken may have lost either message.
            inbox.await_welcome()
        welcome = inbox.welcomes.pop()
        # Ends that were told so far were those of this node's former life.
        inbox.gone.clear()
        config, state = node_changes.begin_late(self._beginning, welcome)
        self.link(config)
        return config, state

    def begin(self) -> None:
        """Take part from the next step on."""
        self._inbox.queues.out = False

    def next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """Wait for what the node needs next.

        Raises:
            GivenUp: the others go on without this node.
        """
        inbox = self._inbox
        events = self._await_next(config, state)
        # An end that was told before the events just heard comes before them.
        while inbox.gone:
            gone = inbox.gone.popleft()
            if gone.node == config.index:
                raise GivenUp
            events = [*inbox.last_words(gone), *events]
        return events

    def _await_next(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        inbox = self._inbox
        if inbox.gone:
            return ()
        self._tell_unreachable(state)
        if inbox.again:
            return inbox.next_repeated(state)
        match state.phase:
            case Phase.MEASUREMENT:
                return inbox.await_one(self._heartbeat)
            case Phase.GRANT:
                return inbox.await_one("grant")
            case _:
                return inbox.await_shares(state_machine.awaited_neighbours(config, state))

    def _tell_unreachable(self, state: NodeState) -> None:
        """Name members to the environment whose links have not come back."""
        while self._unreachable:
            neighbour = self._unreachable.popleft()
            # A node that is out may return, with a link that was away for as long as it was.
            if neighbour not in state.absent and self.transport.missing([str(neighbour)]):
                lost = Unreachable(self._beginning.index, neighbour)
                self.transport.send(topic(lost), encode(lost))

    def settle(self, config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState]:
        """Count messages that could not be used."""
        refused = self._inbox.refused
        if refused.number:
            state = count(state, *["rejected message"] * refused.take())
        return config, state

    def send(self, state: NodeState, messages: Sequence[NodeMessage]) -> None:
        """Publish messages, and keep them for a repetition."""
        self._inbox.finished = state.phase is Phase.FINISHED
        for message in messages:
            self._republisher.say(topic(message), encode(message))

    def await_joined(self, state: NodeState) -> None:
        """Wait for links to nodes that join: each must hear this node's first share."""
        changes = state.inbox.measured[state.step + 1].changes
        joined = {change.node for change in changes if isinstance(change, Joined)}
        peers = {str(j) for j in joined & self._peers}
        self.transport.await_present(peers, _LINK_S)

    def link(self, config: NodeConfig) -> None:
        """Hear the neighbours of a configuration, and wait for links to those that are new."""
        peers = {*peers_of(config.index, config.graph)}
        if config.neighbours == self._neighbours and peers == self._peers:
            return
        new, self._peers, self._neighbours = peers - self._peers, peers, config.neighbours
        at = self._membership.endpoints
        self._inbox.follow({j: at.get(j) for j in config.neighbours})
        for peer in new - {*config.neighbours}:
            self.transport.meet(at.get(peer), [])
        there = {str(j) for j in new - {*config.standing.absent}}
        self.transport.await_present(there, _LINK_S)

    def note(self, config: NodeConfig, before: NodeState, after: NodeState) -> None:
        """No clock is kept."""

    def leave(self) -> None:
        """Wait until the recorder has kept everything, and leave the network."""
        self._republisher.finish()
        self._inbox.await_end()
        self._republisher.close()
        self.transport.close()

    # --- on other threads ------------------------------------------------------------------------

    def _see(self, name: str, is_there: bool) -> None:
        """A process has come or is gone. Runs on: a thread of zenoh's."""
        self._timeout.see(name, is_there)
        if name.isdigit() and int(name) in self._neighbours:
            self._departed.see(name, is_there)
        # A hello is repeated for an environment process that is back, not for the first.
        if self._republisher.see(name, is_there) and name == ENVIRONMENT:
            self._inbox.note_environment_back()

    def _miss(self, name: str) -> None:
        """A neighbour that this node cannot reach may be in reach of the environment process."""
        self._unreachable.append(int(name))
        self._inbox.wake(int(name))

    def _waits_for(self) -> str:
        """The process that this node waits for in the middle of a step, in words."""
        queues = self._inbox.queues
        kind, _, owner = queues.awaited.partition("/")
        if queues.out or kind == "measured":
            return ""
        return f"what node {owner} has to say" if kind == "share" else "a grant of the environment"
