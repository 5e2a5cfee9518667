"""The single-track model of the ADLUKF paper: angles are small, and side slip is v_y over v.

Source: the 3-DOF model that the paper names (its references 21 and 22), docs/papers/adlukf.md.
"""

from dataclasses import dataclass

import numpy as np

from concord.features.vehicle.plant.model import (
    ACCELERATION,
    MIN_SPEED_M_S,
    SIDE_SLIP,
    SPEED,
    STEERING,
    YAW_RATE,
    SingleTrack,
    Tyre,
    axles_of,
)
from concord.features.vehicle.plant.parameters import Car


@dataclass(frozen=True, eq=False)
class SmallAngles(SingleTrack):
    """The model in the first order of its angles, with the attributes of `SingleTrack`."""

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., 3) one step later under control (..., 2)."""
        assert control is not None, "a car is driven: give steering and acceleration"
        car = self.car
        yaw_rate, side_slip, speed = (state[..., i] for i in range(3))
        front, rear = self.axle_forces(state, control[..., STEERING])
        moment = car.front_axle_m * front - car.rear_axle_m * rear
        forward = np.maximum(speed, MIN_SPEED_M_S)
        after = np.empty_like(state)
        after[..., YAW_RATE] = yaw_rate + self.time_step_s * moment / car.yaw_inertia_kg_m2
        turning = (front + rear) / (car.mass_kg * forward) - yaw_rate
        after[..., SIDE_SLIP] = side_slip + self.time_step_s * turning
        driving = yaw_rate * side_slip * speed + control[..., ACCELERATION]
        after[..., SPEED] = speed + self.time_step_s * driving
        return after

    def axle_slips(self, state: np.ndarray, steering: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slip angles (...) of front and rear axle in rad."""
        turn = state[..., YAW_RATE] / np.maximum(state[..., SPEED], MIN_SPEED_M_S)
        front = state[..., SIDE_SLIP] + self.car.front_axle_m * turn - steering
        return front, state[..., SIDE_SLIP] - self.car.rear_axle_m * turn

    def accelerations(
        self, state: np.ndarray, control: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations (...) of the centre of mass: lateral, m/s^2, and of the yaw, rad/s^2."""
        front, rear = self.axle_forces(state, control[..., STEERING])
        moment = self.car.front_axle_m * front - self.car.rear_axle_m * rear
        return (front + rear) / self.car.mass_kg, moment / self.car.yaw_inertia_kg_m2


def small_angles(
    car: Car, tyre: Tyre, time_step_s: float, noise_cov: np.ndarray | None = None
) -> SmallAngles:
    """Return the paper's model of a car; without process noise of its own unless that is given."""
    noise_cov = np.zeros((3, 3)) if noise_cov is None else noise_cov
    return SmallAngles(car, axles_of(car), tyre, time_step_s, noise_cov)
