"""Changes of the network as the environment applies them: between two steps."""

from collections.abc import Sequence

from concord.bus.arbitration import begin_arbitration
from concord.nodes.changes import Change, Event, Joined, Present, Set, Settings, Welcome, after
from concord.nodes.environment import skip_quiet_cycles
from concord.nodes.environment_state import EnvironmentConfig, EnvironmentState
from concord.nodes.messages import EnvironmentMessage, Estimate

# A heartbeat that is late in real time tells of a return so many steps later at most.
_LATE_STEPS = 8


def apply(
    config: EnvironmentConfig, state: EnvironmentState, changes: Sequence[Change]
) -> tuple[EnvironmentConfig, EnvironmentState, list[EnvironmentMessage]]:
    """Apply changes that hold from the next step on; also return messages that tell of them."""
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
            arbiter=begin_arbitration(config.nodes),
        )
        state = skip_quiet_cycles(config, state)
    outbox: list[EnvironmentMessage] = [Event(state.released, change) for change in changes]
    outbox += [
        Welcome(change.node, state.released, standing, change)
        for change in changes
        if isinstance(change, Joined)
    ]
    return config, state, outbox


def setting(config: EnvironmentConfig, state: EnvironmentState, settings: Settings) -> Set:
    """The change after which these fields of the scenario are set, and no others."""
    return Set(settings, config.cycle_of(state.released))


def joining(config: EnvironmentConfig, state: EnvironmentState, node: int) -> Joined | None:
    """How a node comes back: with the newest belief of its neighbours, of the first that has it.

    None while no neighbour can say anything. Before the first step, and where neighbours are
    sensors that believe nothing, the scenario's prior does. When no node is left, a node goes on
    from what it said last itself.
    """
    if state.released == 0:
        return Joined(node)
    absent = state.standing.absent
    there = [j for j in config.neighbours[node] if j not in absent]
    asked = [node] if len(absent) == config.nodes else there
    latest = [estimate for j in asked if (estimate := _newest(state, j)) is not None]
    whole = [estimate for estimate in latest if _whole(estimate)]
    if whole:
        newest = max(whole, key=lambda estimate: estimate.step)
        return _joined(state, node, newest)
    believes_nothing = there and len(latest) == len(there)
    return Joined(node) if believes_nothing or len(absent) == config.nodes else None


class MistakenNodes:
    """Finds members that a node takes for out, and remembers which heartbeats correct it.

    Nodes hear of each end from the environment, so the environment knows it first.
    """

    def __init__(self) -> None:
        # The first step whose heartbeat told a node (the second) that another (the first) is in.
        self._told: dict[tuple[int, int], int] = {}

    def found(
        self, config: EnvironmentConfig, state: EnvironmentState, estimate: Estimate
    ) -> list[Present]:
        """Return the members that the sender of an estimate takes for out, and was not told of."""
        absent, known, sender = state.standing.absent, range(config.nodes), estimate.node
        if sender in absent or state.released == config.steps:
            return []
        false = [
            node
            for node in sorted({*estimate.absent}.intersection(known).difference(absent))
            if state.since.get(node, -_LATE_STEPS) + _LATE_STEPS <= estimate.step
            and self._told.get((node, sender), 0) <= estimate.step
        ]
        self._told |= {(node, sender): state.released for node in false}
        return [Present(node, sender) for node in false]


def _newest(state: EnvironmentState, node: int) -> Estimate | None:
    """A node's last estimate, also of a step that others have not estimated yet."""
    steps = [step for step, heard in state.estimates.items() if node in heard]
    return state.estimates[max(steps)][node] if steps else state.latest.get(node)


def _joined(state: EnvironmentState, node: int, newest: Estimate) -> Joined:
    if newest.step == state.released - 1:
        return Joined(node, newest.mean, newest.cov)
    control = None if state.control is None else state.control.tolist()
    return Joined(node, newest.mean, newest.cov, newest.step, control)


def _whole(estimate: Estimate) -> bool:
    return None not in estimate.mean and None not in estimate.cov
