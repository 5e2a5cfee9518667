"""A plant behind a measurement bus: sensors 1..N share one bus to a receiver, node 0.

A step is one slot. `--schedule` names the sensor that gets it, `--static-slots` is l, `--filter` is
the receiver, `--hold` says what a silent sensor is taken to measure, and `--bid-weights` replaces
the weights of the bids.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.bus.bus import Bus
from concord.bus.schedule import Schedule
from concord.features.measurement_bus.batched_reception import BatchedReception
from concord.features.measurement_bus.gaussian_receiver import System
from concord.features.measurement_bus.measurement_bus import (
    BID_SPAN,
    RECEIVER,
    LosingBids,
    MeasurementBus,
    WeightsAt,
    all_at_once,
    flexray,
    losing_bids_of,
    nobody,
    round_robin,
    try_once_discard,
    zero_input,
    zero_order_hold,
)
from concord.features.measurement_bus.measurement_codec import MeasurementCodec
from concord.features.measurement_bus.measurement_runs import estimate, first_received
from concord.features.measurement_bus.one_by_one import OneByOne
from concord.features.measurement_bus.options import Reception, SensorSlots
from concord.features.measurement_bus.receivers import (
    ReceiverParts,
    check_receiver,
    receiver_definition,
)
from concord.features.measurement_bus.reception import Receiver, ReceiverNode, SensorNode
from concord.features.measurement_bus.stochastic import StochasticSystem
from concord.features.measurement_bus.stochastic_models import SystemModel, SystemSensor
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule, scaled_unscented
from concord.nodes.commands import Inject, Kill, Restart
from concord.nodes.estimator import AnyEstimator
from concord.nodes.lanes.links import Links
from concord.nodes.lanes.network import BatchedRule
from concord.nodes.rules.local_filter import Model, Sensor
from concord.scenarios.node_context import Beginning
from concord.scenarios.scenario import Scenario, require
from concord.scenarios.scenario_definition import (
    NetworkWiring,
    ScenarioDefinition,
    ScenarioPlant,
    Score,
)
from concord.scenarios.script import script_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.assignment import flat
from concord.scenarios.types.schedules import trigger_of
from concord.topology.names import unknown_name

ZERO_ORDER, ZERO_INPUT = "zero-order", "zero-input"
_SILENT = {ZERO_ORDER: zero_order_hold, ZERO_INPUT: zero_input}
_NUMBERS = {"float64": "<f8", "float32": "<f4"}


class SystemTruth(ScenarioPlant, Protocol):
    """A plant whose truth starts about a known mean (n,)."""

    @property
    def prior_mean(self) -> np.ndarray: ...


class PlantOnBus(NamedTuple):
    """A plant, its sensors, and what receivers know of them.

    Attributes:
        plant: the truth, in which node 0 has no sensor.
        model: of the plant at a node, for faults and reports.
        sensor: that of a node; None for node 0.
        system: f, h and noise for Gaussian receivers.
        points: sigma points of unscented receivers.
        weights: Q_j of all sensors in a step.
        first_slot: the step of the first slot.
        bounded: the same plant with bounded noise, for receivers of sets; None where it has none.
        held_half_width: half-width of the held values at first, in the ellipsoid of the paper.
    """

    plant: ScenarioPlant
    model: Model
    sensor: Callable[[int], Sensor | None]
    system: System
    points: SigmaPointRule
    weights: WeightsAt
    first_slot: int = 0
    bounded: Any | None = None
    held_half_width: float = 0.0

    @property
    def sensors(self) -> int:
        """Number of sensors N."""
        return len(self.system.sizes)


def plant_of_system(truth: SystemTruth, system: StochasticSystem) -> PlantOnBus:
    """A plant whose sensors and nodes know its system, with weight 1 for every sensor's bids."""
    ends = np.cumsum([0, *system.sizes]).tolist()
    return PlantOnBus(
        truth,
        SystemModel(system),
        lambda node: (
            None if node == RECEIVER else SystemSensor(system, slice(ends[node - 1], ends[node]))
        ),
        system,
        scaled_unscented(len(truth.prior_mean)),
        equal_weights(system.sizes),
    )


def equal_weights(sizes: Sequence[int]) -> WeightsAt:
    """Weights 1 for the bids of sensors that read so many numbers each."""
    weights = tuple(np.eye(size) for size in sizes)
    return lambda _: weights


PlantOf = Callable[[Scenario], PlantOnBus]
_SCHEDULES: dict[str, Callable[[int, int, int], Schedule]] = {
    "flexray": flexray,
    "round-robin": lambda count, _, first: round_robin(count, range(1, count + 1), first),
    "dynamic": lambda count, *_: try_once_discard(count, range(1, count + 1)),
    "full": lambda count, *_: all_at_once(count),
    "none": lambda count, *_: nobody(count),
}


def measured_definition(defaults: Scenario, plant_of: PlantOf, score: Score) -> ScenarioDefinition:
    """The definition of a plant behind a measurement bus; every receiver serves it."""
    return ScenarioDefinition(
        defaults=defaults,
        check=partial(_check, plant_of),
        plant=lambda scenario: plant_of(scenario).plant,
        model=lambda scenario: plant_of(scenario).model,
        sensor=lambda scenario, node: plant_of(scenario).sensor(node),
        score=score,
        wirings={
            "reception": NetworkWiring(
                share_bytes=lambda scenario: _codec(plant_of(scenario), scenario).size,
                estimator=partial(_estimator, plant_of),
                schedule=lambda scenario: _schedule(plant_of(scenario), scenario),
                batched=partial(_batched, plant_of),
                names=_NAMES,
                bid_span=BID_SPAN,
                lacking=_lacking,
            )
        },
        baseline_filter=partial(_baseline_filter, plant_of),
    )


def bus_of(on_bus: PlantOnBus, scenario: Scenario) -> MeasurementBus:
    """The measurement bus of a scenario."""
    rule = _reception(scenario)
    weights = on_bus.weights
    if rule.bid_weights:
        weights = _asked_weights(rule.bid_weights, on_bus.system.sizes)
    return MeasurementBus(
        on_bus.system.sizes, _schedule(on_bus, scenario), weights, _SILENT[rule.hold.name]
    )


def _schedule(on_bus: PlantOnBus, scenario: Scenario) -> Schedule:
    chosen = scenario.bus.schedule
    static = chosen.static_slots if isinstance(chosen, SensorSlots) else 0
    return _SCHEDULES[chosen.name](on_bus.sensors, static, on_bus.first_slot)


def _reception(scenario: Scenario) -> Reception:
    assert isinstance(scenario.rule, Reception), "the table of rules chose it"
    return scenario.rule


def _codec(on_bus: PlantOnBus, scenario: Scenario) -> MeasurementCodec:
    return MeasurementCodec(max(on_bus.system.sizes), _NUMBERS[_reception(scenario).number])


def _asked_weights(text: str, sizes: Sequence[int]) -> WeightsAt:
    """The weights of `--bid-weights`; rows apart by semicolons take turns, step by step."""
    rule = f"{len(sizes)} positive numbers apart by spaces, and rows of them apart by semicolons"
    rows: list[tuple[np.ndarray, ...]] = []
    for row in text.split(";"):
        try:
            numbers = [float(word) for word in row.split()]
        except ValueError:
            numbers = []
        right = len(numbers) == len(sizes) and all(0 < one < np.inf for one in numbers)
        require(right, "bid_weights", repr(text), rule)
        rows.append(tuple(one * np.eye(size) for one, size in zip(numbers, sizes, strict=True)))
    return lambda step: rows[step % len(rows)]


# --- nodes ---------------------------------------------------------------------------------------


def receiver_of(
    on_bus: PlantOnBus, scenario: Scenario, prior: Gaussian, losing_bids: LosingBids | None
) -> Receiver:
    """The receiver that a scenario chooses."""
    bus = bus_of(on_bus, scenario)
    slots = scenario.bus.schedule
    parts = ReceiverParts(
        on_bus.system,
        on_bus.points,
        on_bus.bounded,
        bus.schedule,
        bus.weights_at,
        slots.static_slots if isinstance(slots, SensorSlots) else None,
        on_bus.held_half_width,
        prior,
        first_received(on_bus.system, prior.mean),
        losing_bids,
    )
    return receiver_definition(scenario.filter).build(scenario.filter, parts)


def _lacking(scenario: Scenario) -> str | None:
    is_back = any(isinstance(one.command, Restart) for one in script_of(scenario))
    return "restarts on a measurement bus (--changes)" if is_back else None


def _estimator(
    plant_of: PlantOf, setup: Setup, node: int, bus: Bus, beginning: Beginning
) -> AnyEstimator:
    scenario = setup.scenario
    on_bus = plant_of(scenario)
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    held = first_received(on_bus.system, prior.mean)
    measuring, codec = bus_of(on_bus, scenario), _codec(on_bus, scenario)
    if node == RECEIVER:
        receiver = receiver_of(on_bus, scenario, prior, losing_bids_of(bus))
        return ReceiverNode(
            receiver, held, measuring.silent, codec, on_bus.first_slot, beginning.step
        )
    return SensorNode(
        states=len(prior.mean),
        neighbours=len(setup.neighbours[node]),
        held=held[measuring.rows(node)],
        weight=lambda step: measuring.weights_at(step)[node - 1],
        silent=measuring.silent,
        codec=codec,
        first_slot=on_bus.first_slot,
    )


def _batched(plant_of: PlantOf, setup: Setup, bus: Bus, links: Links) -> BatchedRule:
    scenario = setup.scenario
    on_bus = plant_of(scenario)
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    receiver = receiver_of(on_bus, scenario, prior, losing_bids_of(bus))
    return BatchedReception(
        OneByOne(receiver) if receiver_definition(scenario.filter).one_by_one else receiver,
        bus_of(on_bus, scenario),
        first_received(on_bus.system, prior.mean),
        _codec(on_bus, scenario),
        links,
        on_bus.first_slot,
    )


def _baseline_filter(
    plant_of: PlantOf, setup: Setup, nodes: Sequence[int], readings: np.ndarray
) -> Gaussian:
    """The scenario's filter with all readings (steps, N, 1, d) of some sensors at every step."""
    scenario = setup.scenario
    on_bus = plant_of(scenario)
    sizes = on_bus.system.sizes
    values = np.full((len(readings), sum(sizes)), np.nan)
    everything = bus_of(on_bus, scenario)
    for node in nodes:
        if node != RECEIVER:
            values[:, everything.rows(node)] = readings[:, node, 0, : sizes[node - 1]]
    prior = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    together = scenario.with_known(schedule="full")[0]
    receiver = receiver_of(on_bus, together, prior, None)
    return estimate(receiver, Received(values, ~np.isnan(values)), on_bus.first_slot)


# --- refusals ------------------------------------------------------------------------------------


def _check(plant_of: PlantOf, scenario: Scenario) -> None:
    on_bus = plant_of(scenario)
    sensors = on_bus.sensors
    who = f"node 0 estimates and hears the sensors, nodes 1 to {sensors}"
    require(scenario.nodes == 1 + sensors, "nodes", scenario.nodes, f"{1 + sensors}: {who}")
    require(scenario.network.graph == "star", "graph", scenario.network.graph, f"star: {who}")
    require(scenario.rounds == 1, "rounds", scenario.rounds, "1: a step is one slot of the bus")
    chosen = flat(scenario)
    for option, known in _NAMES.items():
        if chosen[option] not in known:
            raise unknown_name(f"{option} for a measurement bus", chosen[option], known)
    slots = scenario.bus.schedule
    if isinstance(slots, SensorSlots):
        rule = (
            f"in 0..{sensors - 1}: at least one of {sensors} sensors contends for the dynamic slot"
        )
        require(0 <= slots.static_slots < sensors, "static-slots", slots.static_slots, rule)
    number = _reception(scenario).number
    require(number in _NUMBERS, "number", number, f"{' or '.join(_NUMBERS)}: shares are readings")
    trigger = trigger_of(slots)
    require(trigger == 0, "trigger", trigger, "0: sensors ask in every slot")
    bus = bus_of(on_bus, scenario)
    check_receiver(scenario, on_bus.bounded is not None)
    if getattr(scenario.filter, "losers", False):
        _check_losers(scenario, {node for row in bus.schedule.contender_table for node in row})


def _check_losers(scenario: Scenario, contenders: set[int]) -> None:
    """Refuse faults under which a silent contender need not have lost."""
    for step, command in script_of(scenario):
        struck = isinstance(command, Inject) or (
            isinstance(command, Kill | Restart) and command.node in contenders
        )
        if struck:
            name = command.__struct_config__.tag
            raise ValueError(
                f"--changes {step} {name}: a set is cut by what the losers of a contention cannot "
                "have measured, which holds only while every contender asks; add --no-losers"
            )


_NAMES = {
    "schedule": tuple(_SCHEDULES),
    "hold": tuple(_SILENT),
}
