"""`vehicle-network`: a car's sensors as nodes on its FlexRay bus, one cycle of 5 ms a step.

A --car is simulated with 29 states (CommonRoad) through a --manoeuvre, or a logged drive replayed
with --data. Filters believe in the process noise of the car, times --process-noise. Every node
learns how noisy its own sensors are (with --filter ukf it believes their data sheets). --noise says
what the sensors really do.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from concord.features.vehicle.identification.sought import value_at, with_value
from concord.features.vehicle.options import AdaptiveUnscented, VehicleNetwork
from concord.features.vehicle.plant.cars import FITTED_CARS
from concord.features.vehicle.plant.corrections import channels_of_nodes
from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import (
    POSITION_CHANNELS,
    delays_in,
    logged_channels,
    read_car,
    read_log,
)
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.model import single_track, tanh_tyre
from concord.features.vehicle.plant.network import (
    ERRORS,
    NODES,
    SENSORS_OF_NODES,
    SIDE_SLIP,
    CarSensor,
    DrivenCar,
    DrivenOnce,
    sensor,
    simulated,
)
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.replay import replayed
from concord.features.vehicle.plant.sensors import SensorError
from concord.features.vehicle.plant.validity import outside_model
from concord.filters.gaussian import Gaussian
from concord.plants.recorded.log_file import while_files_stay
from concord.scenarios.definitions.late_readings import refuse_late
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import Declared, Explanation, ScenarioDefinition, Score
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import FlexRay
from concord.scenarios.types.plants import SensorNetwork
from concord.topology.names import unknown_name

TIME_STEP_S = 0.005
"""One cycle of the car's bus."""

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


@while_files_stay
def _logged(data: str) -> DrivenOnce:
    log = read_log(data)
    try:
        return replayed(*log, TIME_STEP_S)
    except ValueError as error:
        raise ValueError(f"{data}: {error}") from None


@cache
def _drive(car: str, manoeuvre: str) -> Drive:
    # Only here: a node believes in a model and never simulates the truth.
    from concord.features.vehicle.plant.truth import TRUE_CARS, simulate

    return simulate(MANOEUVRES[manoeuvre], TRUE_CARS[car], TIME_STEP_S)


@cache
def _simulated(car: str, manoeuvre: str, noise: str) -> DrivenOnce:
    return simulated(_drive(car, manoeuvre), FITTED_CARS[car], NOISES[noise])


def _plant(scenario: Scenario) -> DrivenOnce:
    vehicle = vehicle_of(scenario)
    if vehicle.data is not None:
        return _logged(vehicle.data)
    _check_names(vehicle)
    return _simulated(vehicle.car, vehicle.manoeuvre, vehicle.noise)


def _check_names(vehicle: VehicleNetwork) -> None:
    if vehicle.car not in FITTED_CARS:
        raise unknown_name("car", vehicle.car, FITTED_CARS)
    if vehicle.manoeuvre not in MANOEUVRES:
        raise unknown_name("manoeuvre", vehicle.manoeuvre, MANOEUVRES)


def _all_steps(scenario: Scenario) -> int:
    """Steps of the drive; a simulated one need not be simulated for that."""
    vehicle = vehicle_of(scenario)
    if vehicle.data is not None:
        return _plant(scenario).steps
    _check_names(vehicle)
    return round(MANOEUVRES[vehicle.manoeuvre].duration_s / TIME_STEP_S) + 1


def vehicle_of(scenario: Scenario) -> VehicleNetwork:
    """The car of a scenario, its drive and its sensors."""
    assert isinstance(scenario.plant, VehicleNetwork), "the catalogue chose this file"
    return scenario.plant


@cache
def _believed(car: Car, noise_factor: float, positioned: bool) -> DrivenCar:
    return DrivenCar(single_track(car, tanh_tyre, TIME_STEP_S), noise_factor, positioned)


@while_files_stay
def _car(data: str) -> Car:
    return read_car(data)


@while_files_stay
def _positioned(data: str) -> bool:
    """Whether a log has positions, so that the state holds the place of the car."""
    return set(POSITION_CHANNELS) <= logged_channels(data)


def _model(scenario: Scenario) -> DrivenCar:
    vehicle = vehicle_of(scenario)
    if vehicle.data is None:
        return _believed(FITTED_CARS[vehicle.car], vehicle.process_noise, False)
    return _believed(_car(vehicle.data), vehicle.process_noise, _positioned(vehicle.data))


def _sensor(scenario: Scenario, node: int) -> CarSensor:
    return _sensor_of(scenario, node, _model(scenario))


def _sensor_of(scenario: Scenario, node: int, model: DrivenCar) -> CarSensor:
    own = sensor(node, model.single_track, model.positioned)
    return replace(own, gate=_gate(vehicle_of(scenario).sensor_gate, len(own.sheets)))


_PARAMETERS = {
    "mass": (("mass_kg",), 0.5, 2.0),
    "yaw_inertia": (("yaw_inertia_kg_m2",), 0.4, 2.5),
    "front_stiffness": (("front_stiffness_n_rad",), 0.2, 5.0),
    "rear_stiffness": (("rear_stiffness_n_rad",), 0.2, 5.0),
    "friction": (("friction",), 0.2, 2.0),
    "wheel_speed_scale": (("sensors", "wheel_speed_scale"), 0.8, 1.25),
    "lateral_acceleration_scale": (("sensors", "lateral_acceleration_scale"), 0.8, 1.25),
}
_OFFSETS = {
    "accelerometer_ahead": (("sensors", "accelerometer_ahead_m"), 2.0),
    "yaw_rate_offset": (("sensors", "yaw_rate", "offset"), 0.1),
    "lateral_acceleration_offset": (("sensors", "lateral_acceleration", "offset"), 2.0),
    "longitudinal_acceleration_offset": (("sensors", "longitudinal_acceleration", "offset"), 2.0),
    "steering_offset": (("sensors", "steering", "offset"), 0.1),
}
"""Values of a car's file that `concord identify` may seek: where they are, the least and largest
as factors, or how far they may be off."""


def _declared(scenario: Scenario) -> Declared:
    vehicle = vehicle_of(scenario)
    model = _model(scenario)
    file = model.single_track.car
    paths = {name: one[0] for name, one in (_PARAMETERS | _OFFSETS).items()}
    there = {name: value_at(file, path) for name, path in paths.items()}
    found = {
        name: (there[name], low * there[name], high * there[name])
        for name, (_, low, high) in _PARAMETERS.items()
    }
    for name, (_, most) in _OFFSETS.items():
        found[name] = (there[name], there[name] - most, there[name] + most)

    def bound(values: Mapping[str, float]) -> tuple[DrivenCar, list[CarSensor]]:
        car = file
        for name, value in values.items():
            car = with_value(car, paths[name], value)
        changed = _believed(car, vehicle.process_noise, model.positioned)
        return changed, [_sensor_of(scenario, node, changed) for node in range(len(NODES))]

    return Declared(found, bound)


@cache
def _gate(probability: float, channels: int) -> float | None:
    """Chi-square threshold of a reading; none for no gate."""
    if probability == 0:
        return None
    # Only here: a node without a gate need not wait for it.
    from scipy.special import chdtri

    return float(chdtri(channels, probability))


def _reference_cov(scenario: Scenario) -> float:
    """Variance of the side slip that a log has in place of the truth."""
    data = vehicle_of(scenario).data
    return 0.0 if data is None else _car(data).sensors.side_slip.noise ** 2


@while_files_stay
def _logged_nodes_without_data(data: str) -> tuple[int, ...]:
    there = logged_channels(data)
    of_nodes = enumerate(channels_of_nodes(_car(data)))
    return tuple(node for node, names in of_nodes if there.isdisjoint(names))


def _without_data(scenario: Scenario) -> tuple[int, ...]:
    """Nodes whose sensor a log has no column of."""
    data = vehicle_of(scenario).data
    return () if data is None else _logged_nodes_without_data(data)


@while_files_stay
def _late(data: str) -> tuple[int, ...]:
    """Steps from the instant of a reading to its delivery, which waits for the last channel."""
    car, delays = _car(data), delays_in(data)
    late = []
    for channels, sensors in zip(channels_of_nodes(car), SENSORS_OF_NODES, strict=True):
        pairs = zip(channels, sensors, strict=True)
        there = [(name, getattr(car.sensors, sensor)) for name, sensor in pairs if name in delays]
        longest_s = max((delays[name] + sheet.delay_s for name, sheet in there), default=0.0)
        late.append(max(0, math.ceil(longest_s / TIME_STEP_S - 1e-6)))
    return tuple(late)


def _late_steps(scenario: Scenario) -> tuple[int, ...]:
    vehicle = vehicle_of(scenario)
    return () if vehicle.data is None or vehicle.arrival == "stamped" else _late(vehicle.data)


def _check_arrival(scenario: Scenario) -> None:
    """Refuse late readings that no window can put back."""
    vehicle = vehicle_of(scenario)
    if vehicle.arrival == "stamped":
        return
    if vehicle.data is None:
        raise ValueError("--arrival late: of a log, but this drive is simulated; add --data")
    refuse_late(
        scenario, _late(vehicle.data), "--sensor-gate" * bool(vehicle.sensor_gate), "--arrival late"
    )


def _outside(scenario: Scenario, states: np.ndarray) -> dict[str, np.ndarray]:
    return outside_model(_model(scenario).single_track, states)


def _explain(setup: Setup, beliefs: Gaussian, counted: np.ndarray) -> Explanation:
    data = vehicle_of(setup.scenario).data
    if data is None:
        return Explanation()
    cure = f"`concord identify-car --data {data}` fits the car's model to the log"
    if len(counted) > 1 or not counted.any():
        return Explanation(cure)
    # Only here: a node does not explain its run.
    from concord.features.vehicle.log_cause import explained

    return explained(setup, Gaussian(beliefs.mean[0], beliefs.cov[0]), counted[0], cure)


def _check(scenario: Scenario) -> None:
    if scenario.nodes != len(NODES):
        raise ValueError(
            f"--nodes {scenario.nodes}: the car has {len(NODES)}, {', '.join(NODES)}; leave "
            "--nodes out"
        )
    vehicle = vehicle_of(scenario)
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
    _check_arrival(scenario)
    plant = _plant(scenario)
    if scenario.steps > plant.steps:
        raise ValueError(
            f"--steps {scenario.steps}: the drive has {plant.steps} steps of "
            f"{1e3 * plant.time_step_s:g} ms; ask for fewer, or leave --steps out"
        )


DEFINITION = ScenarioDefinition(
    defaults=Scenario(
        plant=VehicleNetwork(),
        network=SensorNetwork(nodes=len(NODES), graph="complete"),
        rounds=1,
        bus=FlexRay(cluster="audi"),
        filter=AdaptiveUnscented(),
        steps=1,
    ),
    check=_check,
    plant=_plant,
    model=_model,
    sensor=_sensor,
    # The side slip is what the car is estimated for, and what a log may know.
    score=Score(states=(SIDE_SLIP,), unit="rad", nees_states=(SIDE_SLIP,), first_step=200),
    all_steps=_all_steps,
    reference_cov=_reference_cov,
    without_data=_without_data,
    late_steps=_late_steps,
    outside=_outside,
    explain=_explain,
    node_names=NODES,
    declared=_declared,
)
