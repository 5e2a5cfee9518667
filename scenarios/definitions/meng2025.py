"""`meng2025`: six sensors and one estimator on a FlexRay measurement bus, one slot per step.

`--filter` names the filter of the estimator (node 0), `--schedule` the sensor that gets the slot,
`--static-slots` is l, `--hold` says what a silent sensor is taken to measure. Step s is the paper's
s: step 0 is the prior, slot 1 belongs to step 1, and node j is the paper's sensor j.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from concord.bus.measurement_bus import (
    BID_SPAN,
    RECEIVER,
    MeasurementBus,
    all_at_once,
    flexray,
    nobody,
    round_robin,
    try_once_discard,
    zero_input,
    zero_order_hold,
)
from concord.bus.schedule import Schedule
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.filters.stochastic_ukf import RECOMMENDED, MeasurementFilter, Received
from concord.nodes.estimator import AnyEstimator
from concord.nodes.rules.measurement_bus import ReceiverNode, SensorNode
from concord.nodes.rules.measurement_codec import MeasurementCodec
from concord.plants import meng2025
from concord.plants.sensed import SensedPlant, sensors_on_a_bus
from concord.scenarios.definitions import measurement_runs
from concord.scenarios.definitions.measurement_runs import first_received
from concord.scenarios.definitions.stochastic_models import SystemModel, SystemSensor
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import NetworkWiring, ScenarioDefinition, Score
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.buses import FlexRay, SensorSlots, trigger_of
from concord.scenarios.types.filters import RecommendedFilter
from concord.scenarios.types.network import SensorNetwork
from concord.scenarios.types.plants import MeasuredPlantChoice, StochasticReceiver
from concord.scenarios.types.rules import Reception
from concord.topology.names import unknown_name

SYSTEM, SENSORS = meng2025.SYSTEM, meng2025.SENSORS
ZERO_ORDER, ZERO_INPUT = "zero-order", "zero-input"
FILTERS: dict[str, MeasurementFilter] = {"recommended": RECOMMENDED}

_SILENT = {ZERO_ORDER: zero_order_hold, ZERO_INPUT: zero_input}
_EVERYBODY = range(1, SENSORS + 1)
_NUMBERS = {"float64": "<f8", "float32": "<f4"}
_SCHEDULES: dict[str, Callable[[int], Schedule]] = {
    "flexray": lambda static_slots: flexray(SENSORS, static_slots),
    "round-robin": lambda _: round_robin(SENSORS, _EVERYBODY),
    "dynamic": lambda _: try_once_discard(SENSORS, _EVERYBODY),
    "full": lambda _: all_at_once(SENSORS),
    "none": lambda _: nobody(SENSORS),
}


def paper_points(alpha: float = 1.0) -> SigmaPointRule:
    """The points of the paper: gamma = n (alpha^2 - 1), beta = 2."""
    return scaled_unscented(meng2025.STATES, alpha, beta=2.0, kappa=0.0)


@cache
def _plant() -> SensedPlant:
    return meng2025.plant(sensors_on_a_bus(SENSORS))


def _schedule(scenario: Scenario) -> Schedule:
    return _SCHEDULES[scenario.bus.schedule.name](static_slots_of(scenario))


def static_slots_of(scenario: Scenario) -> int:
    """How many sensors own a slot, checked.

    Raises:
        ValueError: no sensor is left to contend.
    """
    assert isinstance(scenario.plant, MeasuredPlantChoice), "the catalogue chose this file"
    slots = scenario.plant.static_slots
    rule = f"in 0..{SENSORS - 1}: at least one of {SENSORS} sensors contends for the dynamic slot"
    require(0 <= slots < SENSORS, "static-slots", slots, rule)
    return slots


def _reception(scenario: Scenario) -> Reception:
    assert isinstance(scenario.rule, Reception), "check refuses others"
    return scenario.rule


def bus_of(scenario: Scenario) -> MeasurementBus:
    """The measurement bus of a scenario."""
    return MeasurementBus(
        SYSTEM.sizes, _schedule(scenario), silent=_SILENT[_reception(scenario).hold.name]
    )


def _codec(scenario: Scenario) -> MeasurementCodec:
    return MeasurementCodec(max(SYSTEM.sizes), _NUMBERS[_reception(scenario).number])


def _sensor(scenario: Scenario, node: int) -> SystemSensor | None:
    return None if node == RECEIVER else SystemSensor(SYSTEM, bus_of(scenario).rows(node))


def _estimator(setup: Setup, node: int) -> AnyEstimator:
    scenario = setup.scenario
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    held = first_received(SYSTEM, prior.mean)
    bus, codec = bus_of(scenario), _codec(scenario)
    if node == RECEIVER:
        method = FILTERS[scenario.filter.name]
        return ReceiverNode(SYSTEM, method, prior, paper_points(), held, bus.silent, codec)
    size = SYSTEM.sizes[node - 1]
    return SensorNode(
        states=len(prior.mean),
        neighbours=len(setup.neighbours[node]),
        held=held[bus.rows(node)],
        weight=np.eye(size),
        silent=bus.silent,
        codec=codec,
    )


def _baseline_filter(setup: Setup, nodes: Sequence[int], readings: np.ndarray) -> Gaussian:
    """The recommended filter with all readings (steps, N, 1, d) of some sensors at every step."""
    values = np.full((len(readings) - 1, SYSTEM.entries), np.nan)
    bus = bus_of(setup.scenario)
    for node in nodes:
        if node != RECEIVER:
            values[:, bus.rows(node)] = readings[1:, node, 0, : SYSTEM.sizes[node - 1]]
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    estimator = measurement_runs.BusFilter(SYSTEM, RECOMMENDED, paper_points(), prior)
    return measurement_runs.estimate(estimator, Received(values, ~np.isnan(values)))


def _check(scenario: Scenario) -> None:
    require(scenario.nodes == 1 + SENSORS, "nodes", scenario.nodes, f"{1 + SENSORS}: {_WHO}")
    require(scenario.network.graph == "star", "graph", scenario.network.graph, f"star: {_WHO}")
    require(scenario.rounds == 1, "rounds", scenario.rounds, "1: a step is one slot of the bus")
    static_slots_of(scenario)
    chosen = flat(scenario)
    for option, known in _NAMES.items():
        if chosen[option] not in known:
            raise unknown_name(f"{option} for a measurement bus", chosen[option], known)
    number = _reception(scenario).number
    require(number in _NUMBERS, "number", number, f"{' or '.join(_NUMBERS)}: shares are readings")
    trigger = trigger_of(scenario.bus.schedule)
    require(trigger == 0, "trigger", trigger, "0: sensors ask in every slot")


_NAMES = {
    "rule": ("reception",),
    "filter": tuple(FILTERS),
    "schedule": tuple(_SCHEDULES),
    "hold": tuple(_SILENT),
}
_WHO = f"node 0 estimates and hears the sensors, nodes 1 to {SENSORS}"

DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=StochasticReceiver(),
        network=SensorNetwork(nodes=1 + SENSORS, graph="star"),
        rule=Reception(),
        rounds=1,
        bus=FlexRay(schedule=SensorSlots()),
        filter=RecommendedFilter(),
        steps=101,
    ),
    check=_check,
    plant=lambda _: _plant(),
    model=lambda _: SystemModel(SYSTEM),
    sensor=_sensor,
    score=Score(states=(0, 1), unit="1", nees_states=(0, 1), first_step=1),
    wiring=NetworkWiring(
        schedule=_schedule,
        share_bytes=lambda scenario: _codec(scenario).size,
        estimator=_estimator,
        names=_NAMES,
        bid_span=BID_SPAN,
    ),
    baseline_filter=_baseline_filter,
)
