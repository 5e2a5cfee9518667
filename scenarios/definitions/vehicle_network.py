"""`vehicle-network`: a car's sensors as nodes on its FlexRay bus, one cycle of 5 ms a step.

A --car is simulated with 29 states (CommonRoad) through a --manoeuvre, or a logged drive replayed
with --data. Every node learns how noisy its own sensors are (--no-adaptive: believes their data
sheets). --noise says what the sensors really do.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from concord.filters.adaptive.sage_husa import NoiseEstimate
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.estimator import AnyEstimator
from concord.nodes.messages import Measured, to_wire
from concord.nodes.rules.adaptive_noise import AdaptedSensor, AdaptiveNoise, declared_noise, learn
from concord.nodes.rules.local_filter import predict_to_step, update_with_own
from concord.plants.vehicle.cars import FITTED_CARS
from concord.plants.vehicle.drive_log import read_car, read_folder
from concord.plants.vehicle.manoeuvres import MANOEUVRES
from concord.plants.vehicle.model import single_track, tanh_tyre
from concord.plants.vehicle.network import (
    ERRORS,
    NODES,
    SIDE_SLIP,
    CarSensor,
    DrivenCar,
    DrivenOnce,
    replayed,
    sensor,
    simulated,
)
from concord.plants.vehicle.parameters import Car
from concord.plants.vehicle.sensors import SensorError
from concord.scenarios.filters import build_filter
from concord.scenarios.node_context import NodeContext
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition, Score
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.network import SensorNetwork
from concord.scenarios.types.plants import VehicleNetwork
from concord.scenarios.types.rules import MeasurementFlooding
from concord.topology.names import unknown_name

TIME_STEP_S = 0.005
"""One cycle of the car's bus."""

PROCESS_VARIANCES = (1e-5, 5e-7, 1e-7)
"""Of yaw rate, side slip and speed in a step: what the single-track model leaves out."""

Errors = tuple[tuple[SensorError, ...], ...]


def _each(change: Callable[[SensorError], SensorError]) -> Errors:
    return tuple(tuple(change(error) for error in channels) for channels in ERRORS)


NOISES: dict[str, Errors] = {
    "matched": ERRORS,
    "growing": _each(lambda error: error._replace(changes=((4.0, 4.0),))),
    "small": _each(lambda error: error._replace(std=0.25 * error.std)),
    "outliers": _each(lambda error: error._replace(outlier_share=0.02)),
    "biased": _each(lambda error: error._replace(bias=error.std)),
}
"""Noise of the sensors, by name. The noise is as in the data sheets, four times as much from 4 s
on, or a quarter as much. Readings have 2 % of outliers of 20 times the noise, or are off by one
standard deviation."""


@cache
def _logged(data: str) -> DrivenOnce:
    return replayed(*read_folder(data), TIME_STEP_S)


@cache
def _simulated(car: str, manoeuvre: str, noise: str) -> DrivenOnce:
    # Only here: a node believes in a model and never simulates the truth.
    from concord.plants.vehicle.truth import TRUE_CARS, simulate

    drive = simulate(MANOEUVRES[manoeuvre], TRUE_CARS[car], TIME_STEP_S)
    return simulated(drive, FITTED_CARS[car], NOISES[noise])


def _plant(scenario: Scenario) -> DrivenOnce:
    vehicle = vehicle_of(scenario)
    if vehicle.data is not None:
        return _logged(vehicle.data)
    if vehicle.car not in FITTED_CARS:
        raise unknown_name("car", vehicle.car, FITTED_CARS)
    if vehicle.manoeuvre not in MANOEUVRES:
        raise unknown_name("manoeuvre", vehicle.manoeuvre, MANOEUVRES)
    return _simulated(vehicle.car, vehicle.manoeuvre, vehicle.noise)


def vehicle_of(scenario: Scenario) -> VehicleNetwork:
    """The car of a scenario, its drive and its sensors."""
    assert isinstance(scenario.plant, VehicleNetwork), "the catalogue chose this file"
    return scenario.plant


@cache
def _believed(name: str, data: str | None) -> DrivenCar:
    car: Car = FITTED_CARS[name] if data is None else read_car(data)
    return DrivenCar(single_track(car, tanh_tyre, TIME_STEP_S, np.diag(PROCESS_VARIANCES)))


def _model(scenario: Scenario) -> DrivenCar:
    vehicle = vehicle_of(scenario)
    return _believed(vehicle.car, vehicle.data)


def _sensor(scenario: Scenario, node: int) -> CarSensor:
    return sensor(node, _model(scenario).single_track)


def _check(scenario: Scenario) -> None:
    if scenario.nodes != len(NODES):
        raise ValueError(
            f"--nodes {scenario.nodes}: the car has {len(NODES)}, {', '.join(NODES)}; leave "
            "--nodes out"
        )
    vehicle = vehicle_of(scenario)
    if vehicle.adaptive and isinstance(scenario.rule, MeasurementFlooding):
        raise ValueError(
            "rule labelled sends readings, whose noise every node takes from the data sheet: use "
            "--no-adaptive with it, or rule ci"
        )
    simulated_only = [
        f"--{option} {getattr(vehicle, option)}"
        for option in ("car", "manoeuvre", "noise")
        if getattr(vehicle, option) != getattr(DEFINITION.defaults.plant, option)
    ]
    if vehicle.data is not None and simulated_only:
        raise ValueError(
            f"{', '.join(simulated_only)}: of simulated drives, but --data {vehicle.data} is a "
            "logged one, which has its own car, course and noise; leave one of the two out"
        )
    plant = _plant(scenario)
    if scenario.steps > plant.steps:
        raise ValueError(
            f"--steps {scenario.steps}: the drive has {plant.steps} steps of "
            f"{1e3 * plant.time_step_s:g} ms; ask for fewer, or leave --steps out"
        )


def _estimator_wrapper(
    scenario: Scenario, context: NodeContext, rule: AnyEstimator
) -> AnyEstimator:
    if not vehicle_of(scenario).adaptive:
        return rule
    assert context.sensor is not None, "every node of the car has a sensor"
    return AdaptiveNoise(rule, context.sensor, scaled_unscented(len(context.prior.mean)))


def _baseline_filter(setup: Setup, nodes: Sequence[int], readings: np.ndarray) -> Gaussian:
    """Beliefs (steps,) of one filter that takes the readings of these nodes, and learns as they."""
    scenario = setup.scenario
    model, points = _model(scenario), scaled_unscented(len(setup.prior_mean))
    own_filter = build_filter(scenario.filter, len(setup.prior_mean))
    belief = Gaussian(np.array(setup.prior_mean), np.array(setup.prior_cov))
    sensors = {node: _sensor(scenario, node) for node in nodes}
    noises: dict[int, NoiseEstimate] = {}
    means, covs = [], []
    for step, delivered in enumerate(readings):
        if step > 0:
            belief = predict_to_step(belief, None, step, model, own_filter).beliefs
        for node, own in sensors.items():
            measured = Measured(node, step, to_wire(delivered[node]))
            taken = own
            if node in noises:
                taken = AdaptedSensor(own, noises[node])
            belief, _ = update_with_own(belief, measured, taken, own_filter)
            for reading in delivered[node]:
                if vehicle_of(scenario).adaptive and not np.isnan(reading).all():
                    noise = noises.get(node) or declared_noise(own, reading)
                    noises[node] = learn(noise, belief, reading, own, points, step)
        means.append(belief.mean)
        covs.append(belief.cov)
    return Gaussian(np.array(means), np.array(covs))


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=VehicleNetwork(),
        network=SensorNetwork(nodes=len(NODES), graph="complete"),
        rounds=1,
        bus=FlexRay(cluster="audi"),
        steps=1,
    ),
    check=_check,
    plant=_plant,
    model=_model,
    sensor=_sensor,
    # The side slip is what the car is estimated for, and what a log may know.
    score=Score(states=(SIDE_SLIP,), unit="rad", nees_states=(SIDE_SLIP,), first_step=200),
    all_steps=lambda scenario: _plant(scenario).steps,
    estimator_wrapper=_estimator_wrapper,
    baseline_filter=_baseline_filter,
)
