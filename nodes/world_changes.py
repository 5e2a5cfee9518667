"""What the world does when the network changes: between two steps, while nothing is under way."""

from collections.abc import Sequence

from nodes.changes import Change, Event, Joined, Set, Settings, Welcome, after
from nodes.messages import Estimate, WorldMessage
from nodes.world import WorldConfig, WorldState, skip_quiet_cycles


def apply(
    config: WorldConfig, state: WorldState, changes: Sequence[Change]
) -> tuple[WorldConfig, WorldState, list[WorldMessage]]:
    """The world with changes that hold from the next step on, and what there is to say of them."""
    resets = any(isinstance(change, Set) for change in changes)
    assert state.idle or not resets, "another bus begins when no step is under way"
    standing = state.standing
    for change in changes:
        standing = after(standing, state.released, change)
    joined = {change.node: state.released for change in changes if isinstance(change, Joined)}
    state = state._replace(
        standing=standing,
        announced=(*state.announced, *changes),
        since={**state.since, **joined},
    )
    if resets:
        assert config.rebuild is not None, "whoever changes settings can rebuild"
        config = config.rebuild(standing)
        state = state._replace(
            next_cycle=config.first_cycle,
            next_group=0,
            won=(),
            bids={},
            arbiter=config.arbiter_state,
        )
        state = skip_quiet_cycles(config, state)
    outbox: list[WorldMessage] = [Event(state.released, change) for change in changes]
    outbox += [
        Welcome(change.node, state.released, standing, change)
        for change in changes
        if isinstance(change, Joined)
    ]
    return config, state, outbox


def setting(config: WorldConfig, state: WorldState, settings: Settings) -> Set:
    """The change after which these fields of the scenario are set, and no others."""
    return Set(settings, config.cycle_of(state.released))


def joining(config: WorldConfig, state: WorldState, node: int) -> Joined | None:
    """How a node comes back: with the belief of the first of its neighbours that has one.

    None while no neighbour can say anything. Before the first step, and where neighbours are
    sensors that believe nothing, the scenario's prior does. When nobody is left, a node goes on
    from what it said last itself.
    """
    if state.released == 0:
        return Joined(node)
    absent = state.standing.absent
    there = [j for j in config.neighbours[node] if j not in absent]
    said = [state.latest[j] for j in there if j in state.latest]
    if len(absent) == config.nodes:
        said = [state.latest[node]] if node in state.latest else []
    for estimate in said:
        if _whole(estimate):
            return Joined(node, estimate.mean, estimate.cov)
    believes_nothing = there and len(said) == len(there)
    return Joined(node) if believes_nothing or len(absent) == config.nodes else None


def _whole(estimate: Estimate) -> bool:
    return None not in estimate.mean and None not in estimate.cov
