"""Drives of the filters' own model with known noise, offsets, delays and mounting of sensors."""

import numpy as np
from msgspec.structs import replace

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import single_track, tanh_tyre
from concord.features.vehicle.plant.network import DrivenCar
from concord.features.vehicle.plant.parameters import (
    BMW_320I,
    Car,
    ProcessNoise,
    SensorSheet,
    SensorSheets,
)

STEP_S, GUST_S = 0.005, 0.3
FILE = replace(BMW_320I, name="the file")
"""The car of the file, which knows nothing of the truth below."""
TRUE = replace(
    BMW_320I,
    name="the truth",
    front_stiffness_n_rad=112e3,
    yaw_inertia_kg_m2=1990.0,
    process_noise=ProcessNoise(
        yaw_rate_rad_s=0.012,
        side_slip_rad=0.004,
        speed_m_s=0.03,
        steering_rad=0.03,
        acceleration_m_s2=0.5,
    ),
    sensors=SensorSheets(
        wheel_speed=SensorSheet(noise=0.05, delay_s=0.02),
        yaw_rate=SensorSheet(noise=0.004, offset=0.006, delay_s=0.01),
        lateral_acceleration=SensorSheet(noise=0.15, offset=0.24, delay_s=0.01),
        longitudinal_acceleration=SensorSheet(noise=0.08, offset=-0.15, delay_s=0.01),
        steering=SensorSheet(noise=0.001, offset=0.008),
        side_slip=SensorSheet(noise=0.002, offset=0.004, delay_s=0.015),
        accelerometer_ahead_m=0.45,
        slip_sensor_ahead_m=0.74,
        lateral_acceleration_scale=1.05,
    ),
)


def simulated_log(
    car: Car, seconds: float, seed: int, slip: bool = True, gusts_m_s2: float = 0.0
) -> tuple[Drive, np.ndarray]:
    """A drive of the model with process noise, and its states (steps, 6), then gusts in m/s².

    Sensors log it that err as the car says.

    The driver steers as the filters believe, by a random walk. With gusts the car is a rigid body:
    lateral forces at the rear axle, which last `GUST_S`, replace the process noise of yaw rate and
    side slip.
    """
    generator, steps = np.random.default_rng(seed), round(seconds / STEP_S)
    model = DrivenCar(single_track(car, tanh_tyre, STEP_S))
    std = np.sqrt(np.diagonal(model.process_noise_cov(0)))
    states = np.zeros((steps, 7))
    states[0, 2] = 20.0
    if gusts_m_s2:
        std[:2] = 0.0
    lasting = np.exp(-STEP_S / GUST_S)
    for k in range(1, steps):
        before, gust = np.split(states[k - 1], [6])
        states[k, :6] = model.transition(before, None, 0) + std * generator.standard_normal(6)
        if gusts_m_s2:
            states[k, :2] += STEP_S * gust * [_turned_by_gusts(car), 1 / before[2]]
            drawn = gusts_m_s2 * np.sqrt(1 - lasting**2) * generator.standard_normal()
            states[k, 6] = lasting * gust.item() + drawn
    readings = {name: _delayed(states, car, name) for name in _OF_STATE}
    sheets = car.sensors

    def logged(name: str) -> np.ndarray:
        sheet, exact = getattr(sheets, name), readings[name]
        return exact + sheet.offset + sheet.noise * generator.standard_normal(exact.shape)

    drive = Drive(
        time_step_s=STEP_S,
        steering_rad=logged("steering"),
        yaw_rate_rad_s=logged("yaw_rate"),
        side_slip_rad=logged("side_slip") if slip else np.full(steps, np.nan),
        speed_m_s=states[:, 2],
        longitudinal_acceleration_m_s2=logged("longitudinal_acceleration"),
        lateral_acceleration_m_s2=logged("lateral_acceleration"),
        wheel_speed_m_s=logged("wheel_speed"),
        heading_rad=np.full(steps, np.nan),
    )
    return drive, states


def _delayed(states: np.ndarray, car: Car, name: str) -> np.ndarray:
    """Readings without noise of the states at the times of the readings, less the delay."""
    delay_steps = getattr(car.sensors, name).delay_s / STEP_S
    steps = np.arange(len(states))
    at = np.clip(steps - delay_steps, 0, None)
    return _OF_STATE[name](np.stack([np.interp(at, steps, one) for one in states.T], -1), car)


def _forces(x: np.ndarray, car: Car) -> tuple[np.ndarray, np.ndarray]:
    track = single_track(car, tanh_tyre, STEP_S)
    return track.axle_forces(x[:, :3], x[:, 4])


def _turned_by_gusts(car: Car) -> float:
    """The yaw acceleration of a gust of 1 m/s²."""
    return -car.rear_axle_m * car.mass_kg / car.yaw_inertia_kg_m2


def _lateral(x: np.ndarray, car: Car) -> np.ndarray:
    """Of a car with rear drive: only the rear wheels push."""
    front, rear = _forces(x, car)
    front = front * np.cos(x[:, 4])
    turning = (car.front_axle_m * front - car.rear_axle_m * rear) / car.yaw_inertia_kg_m2
    turning += _turned_by_gusts(car) * x[:, 6]
    lateral = (front + rear) / car.mass_kg + x[:, 6] + car.sensors.accelerometer_ahead_m * turning
    return car.sensors.lateral_acceleration_scale * lateral


def _wheels(x: np.ndarray, car: Car) -> np.ndarray:
    """Front wheels, which the car does not drive; nothing of the rear."""
    across = x[:, 2] * np.tan(x[:, 1]) + car.front_axle_m * x[:, 0]
    sides = [x[:, 2] + way * 0.5 * car.front_track_m * x[:, 0] for way in (-1, 1)]
    front = [along * np.cos(x[:, 4]) + across * np.sin(x[:, 4]) for along in sides]
    read = [car.sensors.wheel_speed_scale * one for one in front]
    return np.stack([*read, *2 * [np.full(len(x), np.nan)]], axis=-1)


_OF_STATE = {
    "steering": lambda x, car: x[:, 4],
    "yaw_rate": lambda x, car: x[:, 0],
    "side_slip": lambda x, car: np.arctan(
        np.tan(x[:, 1]) + car.sensors.slip_sensor_ahead_m * x[:, 0] / x[:, 2]
    ),
    "longitudinal_acceleration": lambda x, car: (
        x[:, 5] - car.sensors.accelerometer_ahead_m * x[:, 0] ** 2
    ),
    "lateral_acceleration": _lateral,
    "wheel_speed": _wheels,
}
