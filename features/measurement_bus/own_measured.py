"""Scenarios of the user's own behind a measurement bus."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from concord.features.measurement_bus.measured import (
    PlantOnBus,
    equal_weights,
    measured_definition,
    plant_of_system,
)
from concord.features.measurement_bus.measurement_bus import RECEIVER, WeightsAt
from concord.features.measurement_bus.options import Reception, RecommendedFilter, SensorSlots
from concord.features.measurement_bus.sensed import SensedPlant, sensors_on_a_bus
from concord.features.measurement_bus.stochastic import StochasticNonlinearity, StochasticSystem
from concord.filters.filter import Filter
from concord.filters.sigma_points import scaled_unscented
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.plants.own_truth import OwnTruth, sensors_of_nodes
from concord.scenarios.definitions.own import own_score, user_definition
from concord.scenarios.scenario import BusChoice, Scenario
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.filters import FilterBase
from concord.scenarios.types.option import require_kind
from concord.scenarios.types.plants import SensorNetwork, UserPlant
from concord.scenarios.user.values import kept_source

BidWeights = Sequence[ArrayLike] | Callable[[int], Sequence[ArrayLike]]
"""A number or a matrix (m_j, m_j) for each sensor, or a function of the step that gives them."""


@runtime_checkable
class PlantForBus(Protocol):
    """A plant of a kind of its own, which says how it sits behind a measurement bus."""

    def on_a_bus(self, sensors: Sequence[Any]) -> PlantOnBus:
        """Return the plant with its sensors, in the order of their slots.

        Raises:
            ValueError: sensors that do not fit the plant.
        """
        ...


def on_a_measurement_bus(
    plant: OwnPlant | SensedPlant | PlantForBus,
    sensors: Sequence[Any] = (),
    bus: BusChoice | None = None,
    receiver: FilterBase | Filter | str = "recommended",
    *,
    weights: BidWeights | None = None,
    steps: int = 200,
    scored_states: Sequence[int] = (0,),
    first_scored_step: int = 20,
) -> Scenario:
    """A scenario whose sensors 1..N share a bus to a receiver, node 0; a step is one slot.

    Args:
        plant: truth and model: an `OwnPlant`, a `SensedPlant` with stochastic nonlinearities, or
            a `PlantForBus` such as a `BoundedPlant` (which sets need).
        sensors: of that plant, in the order of their slots; a `SensedPlant` has its own.
        bus: kind of bus and schedule; FlexRay with a static slot for half of the sensors, and one
            slot for which the others contend, when left out.
        receiver: as in `--filter`: its name, its value or a filter of your own.
        weights: of the bids; 1 for each sensor when left out.
        steps: sampling instants.
        scored_states: states of the RMSE, all of one unit.
        first_scored_step: scored from here on, so that the start does not rule the figures.

    Raises:
        ValueError: sensors that do not fit the plant, or a scenario that cannot be.
    """
    require_kind("sensors", sensors, Sequence, "a list of sensors")
    on_bus = _plant_on_bus(plant, sensors)
    count = on_bus.sensors
    if weights is not None:
        on_bus = on_bus._replace(weights=_weights_at(weights, on_bus.system.sizes))
    truth = on_bus.plant
    score = own_score(truth.state_units, scored_states, first_scored_step)
    defaults = Scenario(
        plant=UserPlant(),
        network=SensorNetwork(nodes=1 + count, graph="star"),
        rule=Reception(),
        rounds=1,
        bus=bus or FlexRay(schedule=SensorSlots(static_slots=count // 2)),
        filter=RecommendedFilter(),
        steps=steps,
    ).with_(filter=receiver)
    definition = measured_definition(defaults, lambda _: on_bus, score)
    definition.refuse(defaults)
    return user_definition(kept_source(definition)).defaults


def _plant_on_bus(plant: object, sensors: Sequence[Any]) -> PlantOnBus:
    if isinstance(plant, PlantForBus):
        return plant.on_a_bus(sensors)
    if isinstance(plant, OwnPlant):
        if any(not isinstance(sensor, OwnSensor) for sensor in sensors):
            raise ValueError("sensors: an OwnPlant takes OwnSensor and no others")
        return _gaussian(plant, tuple(sensors))
    if isinstance(plant, SensedPlant):
        if sensors:
            raise ValueError("sensors: a SensedPlant takes the sensors of its own and no others")
        placed = replace(plant, placement=sensors_on_a_bus(len(plant.system.sizes)))
        # This plant has no measurement at step 0.
        return plant_of_system(placed, plant.system)._replace(first_slot=1)
    raise ValueError(
        f"plant of type {type(plant).__name__}: give an OwnPlant, a BoundedPlant or a SensedPlant"
    )


def _gaussian(plant: OwnPlant, sensors: tuple[OwnSensor, ...]) -> PlantOnBus:
    nodes = sensors_of_nodes(plant, sensors)
    if plant.angles:
        raise ValueError(
            f"angles {plant.angles}: they have no place behind a measurement bus; let f go on "
            "beyond pi, let sensors read sine and cosine, and leave angles out"
        )
    for number, sensor in enumerate(sensors, start=1):
        if sensor.angles or sensor.gate is not None:
            raise ValueError(
                f"sensor {number}: angles and gate have no place behind a measurement bus; let the "
                "sensor read the sine and the cosine of an angle"
            )
        if sensor.every_s is not None or sensor.start_s or sensor.delay_s or sensor.missing:
            raise ValueError(
                f"sensor {number}: every_s, start_s, delay_s and missing have no place behind a "
                "measurement bus, whose slots say when a sensor reads; leave them out"
            )
    ends = np.cumsum([0, *(sensor.entries for sensor in sensors)])
    noise_cov = np.zeros((ends[-1], ends[-1]))
    for sensor, first, last in zip(sensors, ends, ends[1:], strict=False):
        noise_cov[first:last, first:last] = sensor.noise_cov

    def measure(state: np.ndarray, step: int) -> np.ndarray:
        return np.concatenate([sensor.measure(state, step) for sensor in sensors], axis=-1)

    system = StochasticSystem(
        transition=plant.transition,
        measure=measure,
        sizes=tuple(sensor.entries for sensor in sensors),
        process_noise_cov=plant.process_noise_cov,
        measurement_noise_cov=lambda _: noise_cov,
        process=lambda _: StochasticNonlinearity(plant.states, plant.states),
        measurement=lambda _: StochasticNonlinearity(int(ends[-1]), plant.states),
    )
    return PlantOnBus(
        OwnTruth(plant, (None, *nodes)),
        plant,
        lambda node: None if node == RECEIVER else sensors[node - 1],
        system,
        scaled_unscented(plant.states),
        equal_weights(system.sizes),
    )


def _weights_at(weights: BidWeights, sizes: Sequence[int]) -> WeightsAt:
    """Weights as matrices, tried at step 0.

    Raises:
        ValueError: another number than one for each sensor, or one that is not positive definite.
    """

    def at(step: int) -> tuple[np.ndarray, ...]:
        given = weights(step) if callable(weights) else weights
        if len(given) != len(sizes):
            raise ValueError(f"weights: {len(given)} for {len(sizes)} sensors; give one for each")
        return tuple(_weight(one, size) for one, size in zip(given, sizes, strict=True))

    at(0)
    return at


def _weight(given: ArrayLike, size: int) -> np.ndarray:
    matrix = np.asarray(given, dtype=float)
    matrix = matrix * np.eye(size) if matrix.ndim == 0 else matrix
    fits = matrix.shape == (size, size) and np.isfinite(matrix).all()
    if not fits or np.linalg.eigvalsh((matrix + matrix.T) / 2).min() <= 0:
        raise ValueError(
            f"weights: {given} must be a positive number or a positive definite matrix "
            f"({size}, {size})"
        )
    return matrix
