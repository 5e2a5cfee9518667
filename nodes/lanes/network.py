"""Input of the batched driver: a network as arrays, its rule and bus, and its changes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from concord.bus.arbitration import ArbiterState
from concord.bus.bus import Awards
from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.nodes.environment_state import ControlStep, Delivery, Plant
from concord.nodes.lanes.filter import Counters
from concord.nodes.messages import ReportedTracks

Contest = Callable[
    [ArbiterState, int, int, np.ndarray, np.ndarray, Callable[[], np.ndarray | None]], Awards
]
"""The arbiter of all runs: (memory, cycle, group of it, nodes (C,) that may ask, bids (R, C), how
to find the lengths of their shares) -> awards (R, C); `bids.NO_BID` does not ask."""

Framed = Callable[[int, np.ndarray, np.ndarray | None], tuple[np.ndarray, np.ndarray]]
"""(cycle, who sends (R, N), bytes of each share (R, N); None where all have one length) -> frames,
and bytes of their payload (R, N)."""


class ShareContents(NamedTuple):
    """Contents of a step's shares, for a rule that passes on records.

    body_bytes, checkpoints, records: (rounds, R, N), of what a node sent in a cycle. held: (R, N,
    W, N) bool, whether a node holds what a source took in each of the last W steps, this one last.
    """

    body_bytes: np.ndarray
    checkpoints: np.ndarray
    records: np.ndarray
    held: np.ndarray


class BatchedRule(Protocol):
    """A fusion rule at all nodes of all runs: `concord.nodes.estimator.Estimator` in arrays.

    Contents are values that only the rule reads. Links are those of its network, in its order.
    """

    def start(self, prior: Gaussian) -> Any:
        """The content before the first step, of priors (R, N, n), (R, N, n, n)."""
        ...

    def begin_step(
        self, content: Any, readings: np.ndarray, control: np.ndarray | None, step: int
    ) -> Any:
        """Carry everything to `step` under control (R, p); take readings (R, N, r, d)."""
        ...

    def bids(self, content: Any, nodes: np.ndarray) -> np.ndarray:
        """How urgent a dynamic slot is to these nodes (C,): integers (R, C)."""
        ...

    def exchange(self, content: Any, sends: np.ndarray, lost: np.ndarray | None) -> Any:
        """A communication cycle, or with relays a part of one, in which nodes `sends` (R, N) share
        and all fuse.

        `lost` (R, E) counts the frames that each link loses of a share; None where none does.
        """
        ...

    def belief(self, content: Any) -> Gaussian:
        """Return the current beliefs of the nodes: (R, N, n), (R, N, n, n)."""
        ...

    def ages(self, content: Any) -> np.ndarray:
        """Cycles since what came over each link was sent (R, E); -1 is never."""
        ...

    def counters(self, content: Any) -> Counters:
        """Return the totals since the start."""
        ...

    def spread(self, content: Any) -> ShareContents | None:
        """Return the contents of the step's shares; None if the rule's shares have one length."""
        ...


@runtime_checkable
class RuleWithReturns(BatchedRule, Protocol):
    """One whose nodes may die and come back; records of nodes that began apart have no arrays."""

    def restarted(self, content: Any, nodes: np.ndarray, belief: Gaussian) -> Any:
        """Between two steps: nodes (J,) begin anew with beliefs (R, J, n), and hold nothing."""
        ...


@runtime_checkable
class RuleWithLengths(BatchedRule, Protocol):
    """One whose shares differ in length."""

    def body_bytes(self, content: Any, nodes: np.ndarray) -> np.ndarray:
        """Lengths (R, C) of the shares that these nodes (C,) would send now."""
        ...


@runtime_checkable
class RuleWithCheck(BatchedRule, Protocol):
    """A rule whose nodes test whether what they have heard fits their beliefs."""

    def suspect(self, content: Any) -> np.ndarray:
        """Where it does not fit: (R, N)."""
        ...


@runtime_checkable
class RuleWithPast(BatchedRule, Protocol):
    """A rule that also estimates the states of past steps."""

    def smoothed(self, content: Any) -> Gaussian:
        """States of 0, 1, ... steps ago: mean (R, N, L, n), cov (R, N, L, n, n); NaN for none."""
        ...


@runtime_checkable
class RuleWithTracks(BatchedRule, Protocol):
    """A rule that tracks several targets."""

    def tracks(self, content: Any) -> list[list[ReportedTracks]]:
        """Return the tracks of each node of each run."""
        ...


class RunSettings(NamedTuple):
    """Rule and bus, until the settings change: communication cycles of step k, `rounds` of
    them, begin at `first_cycle + (k - first_step) * rounds`."""

    first_step: int
    first_cycle: int
    rounds: int
    schedule: Schedule
    contest: Contest
    contest_memory: ArbiterState
    framed: Framed
    rule: BatchedRule

    def cycles(self, step: int) -> range:
        """Return the cycles of a step."""
        first = self.first_cycle + (step - self.first_step) * self.rounds
        return range(first, first + self.rounds)


class RunSegment(NamedTuple):
    """Segment of a run: the settings from `first_step` on, until the next segment begins.

    present: (N,) bool, which nodes take part. joined: (node, whose belief it begins with). lost:
    (step, cycle) -> how many frames of a share each link loses (R, E); None where no frame is lost.
    Where the settings differ from those before, all nodes begin anew with their own beliefs.
    """

    first_step: int
    settings: RunSettings
    present: np.ndarray
    joined: tuple[tuple[int, int], ...]
    lost: Callable[[int, int], np.ndarray] | None


@dataclass(frozen=True)
class BatchedNetwork:
    """Everything about R runs of a network.

    initial_state: (R, n). prior: (R, N, n), (R, N, n, n). process: normals (steps, R, q).
    measurement: (steps, R, N, r, d). receivers: (E,) of all links. `segments`: of the run, the
    first from step 0 on.
    """

    plant: Plant
    initial_state: np.ndarray
    prior: Gaussian
    process: np.ndarray
    measurement: np.ndarray
    steps: int
    controller: ControlStep | None
    delivery: Delivery | None
    receivers: np.ndarray
    segments: tuple[RunSegment, ...]
