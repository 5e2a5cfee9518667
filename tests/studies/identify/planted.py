"""Plants whose models have three planted errors each, and logs of them as they really are."""

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

import numpy as np
import xarray
from msgspec.structs import replace

import concord as cc
from concord.features.vehicle.plant.drive_log import write_drive
from concord.studies.identify.readings import readings_of
from tests.features.vehicle.identification.simulated_log import FILE, simulated_log


class Planted(NamedTuple):
    """A scenario that believes what is wrong, and the values that are right."""

    scenario: cc.Scenario
    right: Mapping[str, float]


def log_of(
    plant: Any, sensors: list[Any], truth: Any, steps: int, seed: int, late_s: Mapping[str, float]
) -> xarray.Dataset:
    """The log of one run of a plant as it really is, with some series stamped late."""
    told = cc.own_scenario(plant, sensors, truth=truth, steps=steps).with_(seed=seed)
    values = readings_of(told).values[:, :, 0]
    series = {}
    for node, sensor in enumerate(sensors):
        for entry in range(sensor.entries):
            name = f"{sensor.name} {entry}"
            stamps = plant.time_step_s * np.arange(steps) + late_s.get(sensor.name, 0.0)
            times = f"time_{node}"
            there = np.isfinite(values[:, node, entry])
            row = (times, values[there, node, entry], {})
            series[name] = xarray.DataArray(row[1], {times: stamps[there]}, (times,))
            series[name][times].attrs["units"] = "s"
    return xarray.Dataset(series)


def cart(seed: int) -> Planted:
    """A linear cart that is pushed: too little R, too much Q, a position that is stamped late."""
    move = np.array([[1.0, 0.1], [0.0, 0.98]])
    push = np.array([0.0, 0.1])
    plant = cc.OwnPlant(
        f=lambda x, u: x @ move.T + u * push,
        Q=[1e-6, 4e-3],
        mean=[0.0, 0.0],
        cov=[1.0, 1.0],
        time_step_s=0.1,
        inputs=3 * np.sign(np.sin(0.2 * np.arange(1000))),
        state_names=("place", "speed"),
    )
    sensors = [
        cc.OwnSensor(h=lambda x: x[..., :1], R=0.01, name="gps"),
        cc.OwnSensor(h=lambda x: x[..., 1:], R=0.01, name="wheel"),
    ]
    truth = cc.Truth(Q=[1e-6, 1e-3], sensors=[cc.TrueSensor(R=0.04), None])
    log = log_of(plant, sensors, truth, 600, seed, {"gps": 0.3})
    right = {"R.gps": 2.0, "Q.speed": 0.5, "delay.gps": 0.3}
    return Planted(cc.own_scenario(plant, sensors, readings=log), right)


def pendulum(seed: int) -> Planted:
    """A damped pendulum that wind moves: wrong length, too much R, too little Q."""

    def move(x: np.ndarray, *, length: float) -> np.ndarray:
        angle, rate = x[..., 0], x[..., 1]
        turn = -9.81 / length * np.sin(angle) - 0.1 * rate
        return np.stack((angle + 0.02 * (rate + 0.02 * turn), rate + 0.02 * turn), axis=-1)

    plant = cc.OwnPlant(
        f=move,
        Q=[1e-8, 1e-3],
        mean=[1.0, 0.0],
        cov=[0.01, 0.01],
        time_step_s=0.02,
        state_names=("angle", "rate"),
        parameters={"length": (1.3, 0.5, 2.0)},
    )
    sensors = [
        cc.OwnSensor(h=lambda x: x[..., :1], R=4e-4, name="encoder"),
        cc.OwnSensor(h=lambda x: x[..., 1:], R=0.01, name="gyro"),
    ]
    truth = cc.Truth(
        f=lambda x: move(x, length=1.0), Q=[1e-8, 4e-3], sensors=[cc.TrueSensor(R=1e-4), None]
    )
    log = log_of(plant, sensors, truth, 1000, seed, {})
    right = {"R.encoder": 0.5, "Q.rate": 2.0, "theta.length": 1.0}
    return Planted(cc.own_scenario(plant, sensors, readings=log), right)


def bicycle(seed: int) -> Planted:
    """A bicycle with GPS and a gyroscope: wrong wheelbase, late gyroscope, GPS worse than told."""

    def move(x: np.ndarray, u: np.ndarray, *, wheelbase: float) -> np.ndarray:
        east, north, heading, rate = (x[..., i] for i in range(4))
        speed, steer = u[0], u[1]
        turn = speed / wheelbase * np.tan(steer)
        return np.stack(
            (
                east + 0.05 * speed * np.cos(heading),
                north + 0.05 * speed * np.sin(heading),
                heading + 0.05 * rate,
                rate + 0.3 * (turn - rate),
            ),
            axis=-1,
        )

    steps = 800
    at = np.arange(steps + 10)
    angle = 0.15 * np.sin(0.09 * at) + 0.1 * np.sin(0.031 * at)
    plant = cc.OwnPlant(
        f=move,
        Q=[1e-4, 1e-4, 1e-6, 4e-4],
        mean=[0.0, 0.0, 0.0, 0.0],
        cov=[1.0, 1.0, 0.01, 0.01],
        time_step_s=0.05,
        inputs=np.stack([np.full(steps + 10, 8.0), angle], axis=-1),
        state_names=("east", "north", "heading", "turn rate"),
        parameters={"wheelbase": (2.2, 1.5, 4.0)},
    )
    sensors = [
        cc.OwnSensor(h=lambda x: x[..., :2], R=[0.25, 0.25], name="gps", every_s=0.2),
        cc.OwnSensor(h=lambda x: x[..., 3:], R=1e-4, name="gyro"),
    ]
    truth = cc.Truth(
        f=lambda x, u: move(x, u, wheelbase=2.7), sensors=[cc.TrueSensor(R=[1.0, 1.0]), None]
    )
    log = log_of(plant, sensors, truth, steps, seed, {"gyro": 0.1})
    right = {"R.gps": 2.0, "delay.gyro": 0.1, "theta.wheelbase": 2.7}
    return Planted(cc.own_scenario(plant, sensors, readings=log), right)


def spring(seed: int) -> Planted:
    """A mass on a spring as a continuous model: wrong stiffness, wrong offset of a sensor, wrong R.

    One process noise drives place and speed, so both are one name.
    """

    def rate(x: np.ndarray, *, stiffness: float) -> np.ndarray:
        return np.stack((x[..., 1], -stiffness * x[..., 0] - 0.2 * x[..., 1]), axis=-1)

    push = np.array([0.005, 0.1])
    plant = cc.OwnPlant(
        dynamics=rate,
        Q=0.09 * np.outer(push, push) + 1e-8 * np.eye(2),
        mean=[1.0, 0.0],
        cov=[0.1, 0.1],
        time_step_s=0.1,
        state_names=("place", "speed"),
        parameters={"stiffness": (3.0, 1.0, 10.0), "offset": (0.0, -1.0, 1.0)},
    )
    sensors = [
        cc.OwnSensor(h=lambda x, *, offset: x[..., :1] + offset, R=0.01, name="laser"),
        cc.OwnSensor(h=lambda x: x[..., :1], R=0.01, name="wire"),
    ]
    truth = cc.Truth(
        dynamics=lambda x: rate(x, stiffness=4.0),
        sensors=[cc.TrueSensor(h=lambda x: x[..., :1] + 0.2), cc.TrueSensor(R=0.0025)],
    )
    log = log_of(plant, sensors, truth, 600, seed, {})
    right = {"R.wire": 0.5, "theta.stiffness": 4.0, "theta.offset": 0.2}
    return Planted(cc.own_scenario(plant, sensors, readings=log), right)


def car(seed: int) -> Planted:
    """A car whose front tyres are softer than its file says, with a gyroscope that is better, and
    wheels that are stamped late."""
    sheets = FILE.sensors
    true = replace(
        FILE,
        front_stiffness_n_rad=112e3,
        sensors=replace(
            sheets,
            yaw_rate=replace(sheets.yaw_rate, noise=0.0025),
            wheel_speed=replace(sheets.wheel_speed, delay_s=0.02),
        ),
    )
    folder = Path(mkdtemp())
    write_drive(folder, simulated_log(true, 6.0, seed)[0], FILE)
    right = {"R.yaw_rate": 0.5, "delay.wheel_speed": 0.02, "theta.front_stiffness": 112e3}
    return Planted(cc.scenario("vehicle-network", data=str(folder)), right)


PLANTS: dict[str, Callable[[int], Planted]] = {
    "cart": cart,
    "pendulum": pendulum,
    "bicycle": bicycle,
    "spring": spring,
    "car": car,
}
