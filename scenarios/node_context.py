"""Node context: a node's place in its network, from which its estimator is built."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.bus.schedule import Schedule
from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.turns import Angles
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.nodes.rules.local_filter import LocalFilters, Model, Sensor, SensorGroup
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.rules import CovarianceIntersection, FusionRule

if TYPE_CHECKING:
    from concord.nodes.lanes.links import Links, Shares


class Everybody(NamedTuple):
    """Knowledge that all nodes have of all nodes.

    `sensors` has one entry per node, and `groups` the same with one value for nodes that are alike.
    Readings of each are of shape `readings_shape` (r, d). `late_steps` is as in `WindowFilter`,
    `origin` as in `RuleContext`.
    """

    scenario: Scenario
    schedule: Schedule
    sensors: tuple[Sensor | None, ...]
    groups: tuple[SensorGroup, ...]
    readings_shape: tuple[int, int]
    late_steps: tuple[int, ...] = ()
    origin: np.ndarray | None = None


class Beginning(NamedTuple):
    """The first step of an estimator, and the communication cycle with which it begins.

    `joins`: the network began before, and the node comes back to it.
    """

    step: int = 0
    cycle: int = 0
    joins: bool = False


class RuleContext(NamedTuple):
    """Input of a rule, the same for one node and for all.

    `neighbours` are those that each node of the network hears; `number` is "<f8" or "<f4"; `rule`
    is that of the scenario; without `contends` no node asks for dynamic slots. A belief is of so
    many `models`, and its `angles` are states that are angles. Numbers on the wire are of states
    about the `origin` (n,); None for zero.
    """

    states: int
    neighbours: Sequence[Sequence[int]]
    hold: HoldPolicy
    trigger: float
    number: str
    rule: FusionRule = CovarianceIntersection()
    contends: bool = True
    models: int = 1
    origin: np.ndarray | None = None
    angles: Angles = ()


class NodeContext(NamedTuple):
    """A node's place in the network: all that its estimator is built from.

    `weights` (1 + J,) are the node's own weight, then those of its neighbours; `everybody` tells
    what rules need to know that use the readings of others.
    """

    node: int
    rule: RuleContext
    weights: np.ndarray
    model: Model
    sensor: Sensor | None
    prior: Gaussian
    filter: Filter
    everybody: Callable[[], Everybody] | None = None
    beginning: Beginning = Beginning()


class BatchContext(NamedTuple):
    """Input of a rule at all nodes of many runs.

    `base` are the weights of a run, `contenders` (C,) the nodes that may ask for the dynamic
    segment; `everybody` and `beginning` as in `NodeContext`.
    """

    rule: RuleContext
    filters: LocalFilters
    links: "Links"
    base: "Shares"
    rounds: int
    contenders: np.ndarray
    everybody: Callable[[], Everybody]
    beginning: Beginning = Beginning()
