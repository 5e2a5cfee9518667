"""The single-track model with three degrees of freedom that estimators use, and its tyres.

State [yaw rate rad/s, side slip rad, speed m/s], control [steering rad, acceleration m/s²], where
the acceleration is the body accelerometer's, vx' - yaw rate vy. Angles may be large: forces turn
with the road wheels, and slips are arctangents. The driven axle has all of the longitudinal force.

Source: Newton and Euler in the plane of the road; docs/vehicle.md, equations 1-5.
`papers/adlukf/study.py` has the model of the ADLUKF paper, linear in the angles.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.parameters import Car

Tyre = Callable[[np.ndarray, np.ndarray | float, np.ndarray | float], np.ndarray]
"""Lateral force of an axle (...) in N by slip angle rad, stiffness N/rad and friction limit N."""

MIN_SPEED_M_S = 1.0
"""Slip angles are divided by no less: the model is not for standing cars."""

YAW_RATE, SIDE_SLIP, SPEED = range(3)
STEERING, ACCELERATION = range(2)


def linear_tyre(
    slip: np.ndarray, stiffness: np.ndarray | float, limit: np.ndarray | float
) -> np.ndarray:
    """Force proportional to slip, without limit: (3)."""
    return -stiffness * slip


def tanh_tyre(
    slip: np.ndarray, stiffness: np.ndarray | float, limit: np.ndarray | float
) -> np.ndarray:
    """Force that saturates at the friction limit, of the same slope at no slip."""
    return -limit * np.tanh(stiffness * slip / limit)


class Axles(NamedTuple):
    """Stiffness N/rad and greatest force N of both axles; floats, or arrays of one shape (...)."""

    front_stiffness: np.ndarray | float
    rear_stiffness: np.ndarray | float
    front_limit: np.ndarray | float
    rear_limit: np.ndarray | float


@dataclass(frozen=True, eq=False)
class SingleTrack:
    """A model as filters take it; one explicit Euler step per sample.

    Attributes:
        car: mass and geometry; its tyres are in `axles`.
        axles: of the car, or arrays of candidates, one per lane.
        tyre: law of the lateral force.
        time_step_s: the sampling time.
        noise_cov: (3, 3), what a step does not know.
    """

    car: Car
    axles: Axles
    tyre: Tyre
    time_step_s: float
    noise_cov: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., 3) one step later under control (..., 2)."""
        assert control is not None, "a car is driven: give steering and acceleration"
        yaw_rate, side_slip, speed = (state[..., i] for i in range(3))
        ahead = control[..., ACCELERATION]
        lateral, turning = self.accelerations(state, control)
        cosine, sine = np.cos(side_slip), np.sin(side_slip)
        swerving = cosine * (cosine * lateral - sine * ahead) / np.maximum(speed, MIN_SPEED_M_S)
        after = np.empty_like(state)
        after[..., YAW_RATE] = yaw_rate + self.time_step_s * turning
        after[..., SIDE_SLIP] = side_slip + self.time_step_s * (swerving - yaw_rate)
        driving = yaw_rate * np.tan(side_slip) * speed + ahead
        after[..., SPEED] = speed + self.time_step_s * driving
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (3, 3) of what a step does not know; the same at every step."""
        return self.noise_cov

    def axle_slips(self, state: np.ndarray, steering: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slip angles (...) of front and rear axle in rad: (4)."""
        slope = np.tan(state[..., SIDE_SLIP])
        turn = state[..., YAW_RATE] / np.maximum(state[..., SPEED], MIN_SPEED_M_S)
        front = np.arctan(slope + self.car.front_axle_m * turn) - steering
        return front, np.arctan(slope - self.car.rear_axle_m * turn)

    def axle_forces(self, state: np.ndarray, steering: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (...) across the wheels of front and rear axle in N: (3) and (4)."""
        front_slip, rear_slip = self.axle_slips(state, steering)
        axles = self.axles
        return (
            self.tyre(front_slip, axles.front_stiffness, axles.front_limit),
            self.tyre(rear_slip, axles.rear_stiffness, axles.rear_limit),
        )

    def accelerations(
        self, state: np.ndarray, control: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations (...) of the centre of mass: lateral, m/s², and of the yaw, rad/s².

        Driven front wheels pull along their own direction; what they need for that has a part
        across the car.
        """
        steering, car = control[..., STEERING], self.car
        front, rear = self.axle_forces(state, steering)
        if car.driven_axle == "front":
            pulling = car.mass_kg * control[..., ACCELERATION] * np.tan(steering)
            front = front / np.cos(steering) + pulling
        else:
            front = front * np.cos(steering)
        moment = car.front_axle_m * front - car.rear_axle_m * rear
        return (front + rear) / car.mass_kg, moment / car.yaw_inertia_kg_m2

    def measure(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Lateral acceleration, yaw rate and speed (..., 3) of states (..., 3): z of (5)."""
        value = np.empty_like(state)
        value[..., 0] = self.accelerations(state, control)[0]
        value[..., 1] = state[..., YAW_RATE]
        value[..., 2] = state[..., SPEED]
        return value


def axles_of(car: Car) -> Axles:
    """Return the tyres that a car's parameters describe."""
    return Axles(
        car.front_stiffness_n_rad,
        car.rear_stiffness_n_rad,
        car.friction * car.front_load_n,
        car.friction * car.rear_load_n,
    )


def single_track(
    car: Car, tyre: Tyre, time_step_s: float, noise_cov: np.ndarray | None = None
) -> SingleTrack:
    """Return the model of a car; without process noise of its own unless that is given.

    Raises:
        ValueError: the time step is not positive.
    """
    if not time_step_s > 0:
        raise ValueError(f"time_step_s is {time_step_s}, but a sampling time is positive")
    noise_cov = np.zeros((3, 3)) if noise_cov is None else noise_cov
    return SingleTrack(car, axles_of(car), tyre, time_step_s, noise_cov)
