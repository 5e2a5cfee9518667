"""What an estimator is built from: a node's place in its network."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from bus.schedule import Schedule
from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule
from nodes.messages import Array
from nodes.rules.belief_consensus import HoldPolicy
from nodes.rules.local_filter import Model, Sensor
from scenarios.scenario import Scenario
from scenarios.types.rules import CovarianceIntersection, FusionRule


class Everybody(NamedTuple):
    """What all nodes know of all nodes.

    `sensors` has one entry per node; readings of each are of shape `readings_shape` (r, d).
    """

    scenario: Scenario
    schedule: Schedule
    sensors: tuple[Sensor | None, ...]
    readings_shape: tuple[int, int]


class Beginning(NamedTuple):
    """The first step of an estimator, and the communication cycle with which it begins."""

    step: int = 0
    cycle: int = 0


class Seat(NamedTuple):
    """A node's place in the network: all that its estimator is built from.

    `neighbours` are whom each node of the network hears; `weights` (1 + J,) the node's own weight
    first, then those of its neighbours; `number` is "<f8" or "<f4"; `rule` is
    that of the scenario; `everybody` tells what rules need to know that use the readings of others.
    """

    node: int
    neighbours: Sequence[Sequence[int]]
    weights: Array
    model: Model
    sensor: Sensor | None
    prior: Gaussian
    points: SigmaPointRule
    hold: HoldPolicy
    trigger: float
    number: str
    rule: FusionRule = CovarianceIntersection()
    everybody: Callable[[], Everybody] | None = None
    beginning: Beginning = Beginning()
