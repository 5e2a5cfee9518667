"""The process of a node: one loop around its state machine, whatever paces it.

A `NodePacing` waits for the next events and sends messages. In lockstep it waits for exactly the
message that the node needs next (`runtime/processes/node/lockstep.py`); in real time it takes what
comes until a deadline (`runtime/processes/node/real_time.py`).
"""

from collections.abc import Sequence
from typing import Protocol

from concord.nodes import node as state_machine
from concord.nodes import node_changes
from concord.nodes.messages import NodeEvent, NodeMessage
from concord.nodes.node_state import NodeConfig, NodeState, Phase
from concord.runtime.network.links import ENVIRONMENT, RECORDER
from concord.runtime.network.zenoh_transport import Transport
from concord.runtime.processes.node.membership import Membership


class GivenUp(Exception):
    """The others go on without this node: the environment has given it up, or it is far behind."""


class NodePacing(Protocol):
    """When a node goes on, and which of its messages may be lost."""

    @property
    def transport(self) -> Transport:
        """The node's place in the network."""
        ...

    def configured(self, config: NodeConfig) -> NodeConfig:
        """The configuration of a node that is paced so."""
        ...

    def say_hello(self) -> None:
        """Tell the environment process that this node is ready."""
        ...

    def enter(self) -> tuple[NodeConfig, NodeState]:
        """Ask to be let in to a network that may run, and wait until the node is."""
        ...

    def begin(self) -> None:
        """Take part from the next step on."""
        ...

    def next_events(self, config: NodeConfig, state: NodeState) -> Sequence[NodeEvent]:
        """Wait for the next events, which are none if the wait was interrupted.

        Raises:
            GivenUp: the node has to enter again.
        """
        ...

    def settle(self, config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState]:
        """Count messages that could not be used, and apply a late welcome."""
        ...

    def send(self, state: NodeState, messages: Sequence[NodeMessage]) -> None:
        """Publish the messages of a node that is in this state now."""
        ...

    def await_joined(self, state: NodeState) -> None:
        """Wait for links to nodes that join in the step that begins now."""
        ...

    def link(self, config: NodeConfig) -> None:
        """Hear the neighbours of this configuration, which may be others than before."""
        ...

    def note(self, config: NodeConfig, before: NodeState, after: NodeState) -> None:
        """A step of the state machine was made."""
        ...

    def leave(self) -> None:
        """Wait until the recorder has kept everything, and leave the network."""
        ...


def run_node(membership: Membership, pacing: NodePacing) -> None:
    """Be one node until the recorder says that the run is over.

    Raises:
        LinkError: the network cannot be joined.
    """
    name, config = str(membership.config.index), pacing.configured(membership.config)
    if membership.late:
        pacing.transport.join(name, {ENVIRONMENT, RECORDER})
        config, state = pacing.enter()
    else:
        pacing.transport.join(name, {ENVIRONMENT, RECORDER, *map(str, membership.peers)})
        pacing.say_hello()
        state = state_machine.initial_state(config)
    finished = False
    while not finished:
        try:
            _take_part(pacing, config, state)
            finished = True
        except GivenUp:
            config, state = pacing.enter()
    pacing.leave()


def _take_part(pacing: NodePacing, config: NodeConfig, state: NodeState) -> None:
    """Go on to the last step.

    Raises:
        GivenUp: the others go on without this node.
    """
    pacing.begin()
    while state.phase is not Phase.FINISHED:
        events = pacing.next_events(config, state)
        config, before = pacing.settle(config, state)
        state, messages = state_machine.step(config, before, *events)
        pacing.send(state, messages)
        if state.phase is Phase.CHANGE:
            pacing.await_joined(state)
            config, state, messages = node_changes.apply(config, state)
            pacing.link(config)
            pacing.send(state, messages)
        pacing.note(config, before, state)
