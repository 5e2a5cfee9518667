"""The configuration of a node, and its state between two events."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
from msgspec.structs import replace

from concord.bus.bus import Bus, Fragment
from concord.bus.schedule import Schedule
from concord.nodes.changes import UNCHANGED, Standing
from concord.nodes.estimator import AnyEstimator, EarlierBelief
from concord.nodes.faults.active import HEALTHY, Faults
from concord.nodes.faults.losses import PERFECT, LinkState
from concord.nodes.messages import Grant, Measured


class Phase(Enum):
    """The events that a node waits for."""

    MEASUREMENT = "measurement"
    CHANGE = "change"
    GRANT = "grant"
    SHARES = "shares"
    FINISHED = "finished"


@dataclass(frozen=True)
class NodeConfig:
    """Everything a node knows before the start.

    `graph` has the nodes that each node hears, and `neighbours` those of this node; both ascend, as
    the weights do. `bus` says which node sends when and in which frames.
    `links` says which frames do not arrive, `scenario_links` which would not without any change.
    `faults` are all other faults. In a `timed` network a group ends when its time is over
    (`CycleClosed`), and not when all its frames have come.

    The configuration holds from `first_step` on, whose cycles begin at `first_cycle`. `standing` is
    what changes have made of the network; `rebuild(standing, step, belief)` makes the configuration
    that goes with it, of a node that begins anew at a step, from a belief or the scenario's prior.
    """

    index: int
    graph: Sequence[Sequence[int]]
    rounds: int
    steps: int
    bus: Bus
    estimator: AnyEstimator
    links: LinkState = PERFECT
    first_step: int = 0
    first_cycle: int = 0
    standing: Standing = UNCHANGED
    rebuild: "Callable[[Standing, int, EarlierBelief | None], NodeConfig] | None" = None
    timed: bool = False
    faults: Faults = HEALTHY
    scenario_links: LinkState = PERFECT

    @cached_property
    def neighbours(self) -> tuple[int, ...]:
        """The nodes that this node hears."""
        return tuple(self.graph[self.index])

    @property
    def schedule(self) -> Schedule:
        """The schedule: which nodes may send in which cycle."""
        return self.bus.schedule

    def groups(self, cycle: int) -> "tuple[NodeGroup, ...]":
        """The groups of frames that are composed at once, in order of time."""
        # Kept: a node asks with every event, and turns repeat.
        turn = cycle % self._period
        known = self._known_turns.get(turn)
        if known is None:
            groups = self.schedule.groups(cycle)
            known = tuple(
                NodeGroup(*group, tuple(j for j in self.neighbours if j in group.senders))
                for group in groups
            )
            self._known_turns[turn] = known
        return known

    @cached_property
    def hears_all(self) -> bool:
        """Whether frames arrive as they were sent."""
        return self.links.perfect and not self.faults.are_active

    @cached_property
    def _period(self) -> int:
        return self.schedule.period

    @cached_property
    def _known_turns(self) -> "dict[int, tuple[NodeGroup, ...]]":
        return {}


class NodeGroup(NamedTuple):
    """A group of a cycle (`Group`), and the node's neighbours among its senders,
    ascending."""

    senders: tuple[int, ...]
    dynamic_slots: int
    neighbours: tuple[int, ...]


class Inbox(msgspec.Struct, frozen=True):
    """Messages that came before their time.

    Heartbeats are kept by step, grants by (cycle, group), shares and their parts by (cycle,
    sender). A frame that the link has lost is None: the node does not wait for it.

    Frames of later steps wait in `early` by (sender, cycle, frame ID, count): changes may come
    before them, and say what they are. `overtaken` shares by (cycle, sender) come after all others
    of their cycle: their fragments when these have all come, () before. `late` frames are under way
    with the cycle in which they come.
    """

    measured: dict[int, Measured]
    grants: dict[tuple[int, int], Grant]
    parts: dict[tuple[int, int], dict[int, bytes | None]]
    shares: dict[tuple[int, int], Any]
    early: dict[tuple[int, int, int, int | None], tuple[Fragment, bytes]]
    overtaken: dict[tuple[int, int], tuple[bytes | None, ...]]
    late: tuple[tuple[int, bytes], ...] = ()


class NodeState(msgspec.Struct, frozen=True):
    """A node between two events.

    `step` is the last begun, `cycle` the one that is open or next, `group` its open group. `won`
    are the nodes that have had a dynamic slot in earlier groups of the cycle, `absent` those that
    are out. `pattern` is a heartbeat as all are formed.
    """

    phase: Phase
    step: int
    cycle: int
    group: int
    won: tuple[int, ...]
    content: Any
    inbox: Inbox
    counters: dict[str, int]
    absent: frozenset[int] = frozenset()
    pattern: Measured | None = None


def count(state: NodeState, *names: str) -> NodeState:
    """One more of each of these."""
    return replace(state, counters=counted(state.counters, *names)) if names else state


def counted(counters: dict[str, int], *names: str) -> dict[str, int]:
    """Counters with one more of each of these."""
    counters = counters.copy()
    for name in names:
        counters[name] = counters.get(name, 0) + 1
    return counters


State = TypeVar("State")
PhaseT = TypeVar("PhaseT", bound=Enum)


class Transition(NamedTuple, Generic[State, PhaseT]):
    """An event in a phase: `handle(config, state, event, outbox)` returns the next state.

    The next state is in one of the phases `leads_to`.
    """

    handle: Callable[..., State]
    leads_to: tuple[PhaseT, ...]


class Completion(NamedTuple, Generic[State, PhaseT]):
    """A transition without an event of its own: it happens as soon as `is_due(config, state)`.

    `go_on(config, state, outbox)` returns the next state, in one of the phases `leads_to`.
    """

    is_due: Callable[..., bool]
    go_on: Callable[..., State]
    leads_to: tuple[PhaseT, ...]
