"""A scenario definition: the functions that build its parts, and how errors are scored."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from concord.bus.bus import Bus
from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.nodes.environment_state import Delivery
from concord.nodes.estimator import AnyEstimator
from concord.nodes.rules.local_filter import Model, Sensor, SensorGroup
from concord.scenarios.node_context import Beginning
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    from concord.nodes.lanes.links import Links
    from concord.nodes.lanes.network import BatchedRule


class ScenarioPlant(Protocol):
    """A plant as a scenario needs it; `concord.nodes.environment_state.Plant` is the part of the
    environment."""

    @property
    def time_step_s(self) -> float: ...

    @property
    def state_names(self) -> tuple[str, ...]: ...

    @property
    def state_units(self) -> tuple[str, ...]: ...

    def draw(self, generator_for: Callable[[str, int], np.random.Generator], steps: int) -> Any: ...

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray: ...

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray: ...

    def positions(self, step: int) -> np.ndarray | None: ...


class ControlLaw(Protocol):
    """A controller: `control(state_estimate (n,), memory, step) -> (control (p,), memory)`."""

    @property
    def initial_memory(self) -> np.ndarray: ...

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]: ...


class Score(NamedTuple):
    """States on which errors are scored: `states` for RMSE, in `unit`; `nees_states` for NEES.

    Scored from `first_step` on, but not before the first reading of any node. Where `near_s` is
    given, also scored for the steps at most that long after a reading by any node.
    """

    states: tuple[int, ...]
    unit: str
    nees_states: tuple[int, ...]
    first_step: int
    near_s: float | None = None


class NetworkWiring(NamedTuple):
    """Building blocks of a rule of a network in which not every node filters and fuses.

    Attributes:
        share_bytes: length of a share.
        estimator: (setup, node, bus, where the node begins) -> that of the node.
        schedule: which nodes may publish in which cycle; None for the schedule of the options.
        batched: (setup, bus, links) -> all nodes of many runs; None where `lacking` refuses all.
        names: what the options schedule and hold may be here, where not all may.
        bid_span: least and largest bid, where nodes bid with logarithms; None otherwise.
        check: raises ValueError for a network that it cannot be.
        lacking: what of a scenario has no array form; None if all has.
    """

    share_bytes: Callable[[Scenario], int]
    estimator: Callable[[Setup, int, Bus, Beginning], AnyEstimator]
    schedule: Callable[[Scenario], Schedule] | None = None
    batched: Callable[[Setup, Bus, "Links"], "BatchedRule"] | None = None
    names: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    bid_span: tuple[int, int] | None = None
    check: Callable[[Setup], None] = lambda _: None
    lacking: Callable[[Scenario], str | None] = lambda _: None


class Explanation(NamedTuple):
    """Explanation of runs by a plant's own data, beside their innovations.

    Attributes:
        cure: of a model that does not move as the readings do.
        cause: the sentence on what explains most of what innovations leave unexplained; empty if
            nothing does.
        misread: in place of `cause`, of a channel whose innovations no noise explains.
        errors: the sentence on errors of estimates, in place of that on ANEES beside the truth;
            empty for none.
        anees: ANEES behind `errors`, and the ends of its interval.
    """

    cure: str = "raise Q, or model that part"
    cause: str = ""
    misread: str = ""
    errors: str = ""
    anees: tuple[float, float, float] = (np.nan, np.nan, np.nan)


class Declared(NamedTuple):
    """Parameters of a plant: value, least and largest of each by name. `bound` maps values of them
    to the model of the plant and the sensors of the nodes, None for a blind node."""

    parameters: Mapping[str, tuple[float, float, float]]
    bound: Callable[[Mapping[str, float]], tuple[Model, Sequence[Sensor | None]]]


class ScenarioDefinition(NamedTuple):
    """One named scenario.

    Attributes:
        defaults: the scenario when nothing is asked for.
        check: raises ValueError for what this scenario cannot be.
        plant, model: of a scenario.
        sensor: of a scenario and a node; None for a blind node.
        sensors: those of all nodes as one value whose arrays have the nodes' axis; None where they
            are too unlike for that.
        score: how its errors are measured.
        reference_cov: covariance of what stands for the truth in the states of `score.nees_states`;
            0 where the truth is exact.
        controller: of a scenario, None where nothing drives the plant.
        warnings: what a user must be told of the plant before a run.
        radio_range_m: reach of a node in the geometric graph, for plants that have positions.
        all_steps: how many steps recorded data hold; None where any number will do.
        points: the sigma points of unscented filters, None for those of concord.
        wirings: by the name of its rule, a network in which not every node filters and fuses; empty
            where every node does, by any rule.
        delivery: what lies between sensors and their nodes, None where readings arrive as taken.
        baseline_filter: (setup, nodes, readings (steps, N, r, d)) -> beliefs (steps,) of one
            filter that takes the readings of these nodes; None for the one that model and sensors
            give.
        without_data: nodes of a scenario to which no reading ever comes. Where all hear all, they
            send no share and own no slot.
        late_steps: after how many steps the sensor of each node delivers a reading, for rules that
            filter a window; empty where all deliver at once.
        irregular: why readings are no fixed function of states and normals; "" where they are one.
        outside: (scenario, states (..., n)) -> for which states (...) the model does not hold, by
            the reason; None for a model that always does.
        results, page: "module:MEMBER" of what results (`RunExtras`) and the page (`OwnPage`) know
            of this scenario alone; "" for nothing. No node loads them.
        explain: (setup, beliefs (R, S, n) of the filter that hears everything, steps that count (R,
            S)) -> what the plant's own data tell of R runs.
        node_names: of all nodes; empty where numbers are their names.
        origin: a point (n,) near the states, the same for all runs, about which shares and readings
            are written; None for zero.
        with_data: (definition, data) -> the definition with the readings of the log that `--data`
            names, for scenarios of the user's own; None where they take none.
        declared: parameters of model and sensors that `concord identify` may seek; None for none.
        is_received: whether run.json told all that is known, and model and sensors are refused.
    """

    defaults: Scenario
    check: Callable[[Scenario], None]
    plant: Callable[[Scenario], ScenarioPlant]
    model: Callable[[Scenario], Model]
    sensor: Callable[[Scenario, int], Sensor | None]
    score: Score
    controller: Callable[[Scenario], ControlLaw | None] = lambda _: None
    warnings: Callable[[Scenario], tuple[str, ...]] = lambda _: ()
    radio_range_m: float | None = None
    all_steps: Callable[[Scenario], int] | None = None
    points: Callable[[Scenario], SigmaPointRule] | None = None
    wirings: Mapping[str, NetworkWiring] = MappingProxyType({})
    delivery: Callable[[Scenario], Delivery] | None = None
    baseline_filter: Callable[[Setup, Sequence[int], np.ndarray], Gaussian] | None = None
    sensors: Callable[[Scenario], Sensor] | None = None
    reference_cov: Callable[[Scenario], np.ndarray | float] = lambda _: 0.0
    without_data: Callable[[Scenario], tuple[int, ...]] = lambda _: ()
    late_steps: Callable[[Scenario], tuple[int, ...]] = lambda _: ()
    irregular: Callable[[Scenario], str] = lambda _: ""
    outside: Callable[[Scenario, np.ndarray], dict[str, np.ndarray]] | None = None
    results: str = ""
    page: str = ""
    explain: Callable[[Setup, Gaussian, np.ndarray], Explanation] = lambda *_: Explanation()
    node_names: tuple[str, ...] = ()
    origin: Callable[[Scenario], np.ndarray | None] = lambda _: None
    declared: Callable[[Scenario], Declared | None] = lambda _: None
    with_data: "Callable[[ScenarioDefinition, str], ScenarioDefinition] | None" = None
    is_received: bool = False

    def wiring(self, scenario: Scenario) -> NetworkWiring | None:
        """The wiring of the scenario's rule; None where every node filters and fuses.

        Raises:
            ValueError: the network is not wired for this rule.
        """
        if not self.wirings:
            return None
        rule, known = scenario.rule.name, " or ".join(self.wirings)
        require(rule in self.wirings, "rule", rule, f"{known}: {scenario.name} has no other rule")
        return self.wirings[rule]

    def refuse(self, scenario: Scenario) -> None:
        """Refuse a scenario for which there is no wiring, or that it cannot be.

        Raises:
            ValueError: naming the option, its value and the cure.
        """
        self.wiring(scenario)
        self.check(scenario)

    def sensor_groups(self, scenario: Scenario) -> tuple[SensorGroup, ...]:
        """The sensors of all nodes: one for all where the scenario has such, else one for each."""
        if self.sensors is not None:
            return (SensorGroup(slice(None), self.sensors(scenario)),)
        single = ((node, self.sensor(scenario, node)) for node in range(scenario.nodes))
        return tuple(SensorGroup(slice(i, i + 1), one) for i, one in single if one is not None)
