"""Changes of the network at a node: a new configuration, and a state that goes with it."""

import dataclasses

import numpy as np
from msgspec.structs import replace

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import unpack_upper
from concord.nodes import node as state_machine
from concord.nodes.changes import Joined, Present, Set, Standing, Welcome, after
from concord.nodes.estimator import EarlierBelief
from concord.nodes.faults.losses import LinkState
from concord.nodes.messages import NodeMessage, from_wire
from concord.nodes.node_state import NodeConfig, NodeState, Phase, count


def apply(config: NodeConfig, state: NodeState) -> tuple[NodeConfig, NodeState, list[NodeMessage]]:
    """Leave phase CHANGE: as `state_machine.step`, with the configuration from this step on.

    Other settings begin anew from what the node believes, and hold nothing of its neighbours; all
    other changes leave the estimator as it is.
    """
    assert state.phase is Phase.CHANGE, "changes come with the heartbeat of their first step"
    step = state.step + 1
    measured = state.inbox.measured[step]
    standing = config.standing
    for change in measured.changes:
        standing = after(standing, step, change)
    unchanged = {**state.inbox.measured, step: replace(measured, changes=())}
    if any(isinstance(change, Set) for change in measured.changes):
        belief = config.estimator.belief(state.content)
        try:
            config = _rebuilt(config, standing, step, EarlierBelief(belief, step - 1))
        except ValueError:
            # The environment checks its changes; this one came from another process.
            standing = config.standing
            state = count(state, "rejected change")
        else:
            state = replace(state, cycle=config.first_cycle, content=config.estimator.start())
    config = _with_standing(config, standing)
    joined = {change.node for change in measured.changes if isinstance(change, Joined)}
    told = [change for change in measured.changes if isinstance(change, Present)]
    present = {change.node for change in told if change.mistaken == config.index}
    state = count(state, *["falsely absent" for _ in present & state.absent])
    state = replace(
        state,
        phase=Phase.MEASUREMENT,
        # A node whose end was told since then is out as well; a later heartbeat names it.
        absent=(state.absent - joined - present) | {*standing.absent},
        inbox=replace(state.inbox, measured=unchanged),
    )
    outbox: list[NodeMessage] = []
    return config, state_machine.advance(config, state, outbox), outbox


def restore(config: NodeConfig, state: NodeState, welcome: Welcome) -> tuple[NodeConfig, NodeState]:
    """A node that was given up and has gone on by itself learns what it has missed; it keeps what
    it believes."""
    standing = welcome.standing
    return _with_standing(config, standing), replace(state, absent=frozenset(standing.absent))


def begin_late(config: NodeConfig, welcome: Welcome) -> tuple[NodeConfig, NodeState]:
    """A node that joins a network that runs: `config` is that of the beginning."""
    standing, step = welcome.standing, welcome.step
    config = _rebuilt(config, standing, step, _belief(welcome.joined, step))
    config = _with_standing(config, standing)
    cycle = config.first_cycle + (step - config.first_step) * config.rounds
    return config, replace(state_machine.initial_state(config), step=step - 1, cycle=cycle)


def _with_standing(config: NodeConfig, standing: Standing) -> NodeConfig:
    return dataclasses.replace(
        config,
        standing=standing,
        links=with_standing(config.scenario_links, standing),
        faults=config.faults.stand(standing),
    )


def with_standing(links: LinkState, standing: Standing) -> LinkState:
    """Links to which this has happened."""
    return links._replace(
        loss=links.loss if standing.loss is None else standing.loss,
        losses={
            **links.losses,
            **{(sender, receiver): loss for sender, receiver, loss in standing.losses},
        },
        cuts=frozenset(standing.cuts),
    )


def _rebuilt(
    config: NodeConfig, standing: Standing, step: int, belief: EarlierBelief | None
) -> NodeConfig:
    assert config.rebuild is not None, "whoever changes settings can rebuild"
    return config.rebuild(standing, step, belief)


def _belief(joined: Joined, step: int) -> EarlierBelief | None:
    if joined.mean is None or joined.cov is None:
        return None
    belief = Gaussian(from_wire(joined.mean), unpack_upper(from_wire(joined.cov)))
    control = None if joined.control is None else np.array(joined.control)
    return EarlierBelief(belief, step - 1 if joined.step is None else joined.step, control)
