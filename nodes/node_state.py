"""What a node knows before the start, and what it is between two events."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import NamedTuple

import msgspec
from msgspec.structs import replace

from bus.publication import Slot
from bus.schedule import Schedule
from filters.gaussian import Gaussian
from nodes.changes import UNCHANGED, Standing
from nodes.estimator import Content, Estimator, Share
from nodes.faults import HEALTHY, Faults
from nodes.link_state import PERFECT, LinkState
from nodes.messages import Measured
from nodes.share import CYCLE_COUNTS, Fragment


class Phase(Enum):
    """What a node waits for."""

    MEASUREMENT = "measurement"
    CHANGE = "change"
    GRANT = "grant"
    SHARES = "shares"
    FINISHED = "finished"


@dataclass(frozen=True)
class NodeConfig:
    """Everything a node knows before the start.

    `neighbours` ascend, as the weights do; `slots(node, cycle)` are those of a node's share;
    the cluster's cycle counter wraps at `cycle_counts`; `links` says which frames do not arrive,
    `scenario_links` which would not if nothing had changed, `faults` what else is wrong. In a
    `timed` network a part of a cycle ends when its time is over (`CycleClosed`), and not when all
    has come.

    The configuration holds from `first_step` on, whose cycles begin at `first_cycle`. `standing` is
    what changes have made of the network; `rebuild(standing, step, belief)` makes the configuration
    that goes with it, of a node that begins anew at a step, from a belief or the scenario's prior.
    """

    index: int
    neighbours: tuple[int, ...]
    rounds: int
    steps: int
    schedule: Schedule
    slots: Callable[[int, int], tuple[Slot, ...]]
    estimator: Estimator
    cycle_counts: int = CYCLE_COUNTS
    links: LinkState = PERFECT
    first_step: int = 0
    first_cycle: int = 0
    standing: Standing = UNCHANGED
    rebuild: "Callable[[Standing, int, Gaussian | None], NodeConfig] | None" = None
    timed: bool = False
    faults: Faults = HEALTHY
    scenario_links: LinkState = PERFECT

    def parts(self, cycle: int) -> "tuple[Part, ...]":
        """What is composed at once in a cycle, in order of time."""
        # Kept: a node asks with every event, and turns repeat.
        turn = cycle % self._period
        known = self._known_turns.get(turn)
        if known is None:
            groups = self.schedule.groups(cycle)
            known = tuple(
                Part(*group, tuple(j for j in self.neighbours if j in group.senders))
                for group in groups
            )
            self._known_turns[turn] = known
        return known

    @cached_property
    def hears_all(self) -> bool:
        """What is sent arrives as it was sent."""
        return self.links.perfect and not self.faults.standing

    @cached_property
    def _period(self) -> int:
        return self.schedule.period

    @cached_property
    def _known_turns(self) -> "dict[int, tuple[Part, ...]]":
        return {}


class Part(NamedTuple):
    """A group of a cycle (`bus.schedule.Group`), and the node's neighbours among its senders,
    ascending."""

    senders: tuple[int, ...]
    dynamic_slots: int
    neighbours: tuple[int, ...]


class Inbox(msgspec.Struct, frozen=True):
    """What has come before its time: heartbeats by step, grants by (cycle, group), shares and their
    parts by (cycle, sender). What the link has lost is None: nobody waits for it any more.

    Frames of later steps wait in `early` by (sender, cycle, frame ID): changes may come before
    them, and say what they are. `overtaken` shares by (cycle, sender) come after all others of
    their cycle: their fragments when these have all come, () before. `late` frames are under way
    with the cycle in which they come.
    """

    measured: dict[int, Measured]
    grants: dict[tuple[int, int], tuple[int, ...]]
    parts: dict[tuple[int, int], dict[int, bytes | None]]
    shares: dict[tuple[int, int], Share | None]
    early: dict[tuple[int, int, int], tuple[Fragment, bytes]]
    overtaken: dict[tuple[int, int], tuple[bytes | None, ...]]
    late: tuple[tuple[int, bytes], ...] = ()


class NodeState(msgspec.Struct, frozen=True):
    """A node between two events.

    `step` is the last begun, `cycle` the one that is open or next, `group` its open part; `won` are
    the nodes that have had a dynamic slot in earlier parts of it; `absent` those that are out;
    `pattern` is a heartbeat as all are formed.
    """

    phase: Phase
    step: int
    cycle: int
    group: int
    won: tuple[int, ...]
    content: Content
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
