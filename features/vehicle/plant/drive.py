"""A drive of a car, sampled evenly: simulated, or read from a log."""

from typing import NamedTuple

import numpy as np

FRONT_LEFT, FRONT_RIGHT, REAR_LEFT, REAR_RIGHT = range(4)
"""Columns of `wheel_speed_m_s`."""


class Drive(NamedTuple):
    """Time series of a drive of (steps,) samples; NaN where a value is unknown.

    ISO 8855 axes at the centre of mass: x forward, y left, yaw positive to the left.

    Attributes:
        time_step_s: between samples.
        steering_rad: road-wheel angle.
        yaw_rate_rad_s, side_slip_rad (atan vy / vx), speed_m_s (vx).
        longitudinal_acceleration_m_s2, lateral_acceleration_m_s2: the readings of a levelled
            accelerometer, vx' - yaw rate vy and vy' + yaw rate vx.
        wheel_speed_m_s: circumference speeds (steps, 4).
        heading_rad: yaw angle, 0 at the start.
    """

    time_step_s: float
    steering_rad: np.ndarray
    yaw_rate_rad_s: np.ndarray
    side_slip_rad: np.ndarray
    speed_m_s: np.ndarray
    longitudinal_acceleration_m_s2: np.ndarray
    lateral_acceleration_m_s2: np.ndarray
    wheel_speed_m_s: np.ndarray
    heading_rad: np.ndarray

    @property
    def steps(self) -> int:
        """Number of samples."""
        return len(self.steering_rad)

    @property
    def time_s(self) -> np.ndarray:
        """(steps,), from 0."""
        return self.time_step_s * np.arange(self.steps, dtype=np.float64)

    @property
    def lateral_speed_m_s(self) -> np.ndarray:
        """vy (steps,)."""
        return self.speed_m_s * np.tan(self.side_slip_rad)

    @property
    def states(self) -> np.ndarray:
        """Yaw rate, side slip and speed (steps, 3), the state of `vehicle_model.SingleTrack`."""
        return np.stack([self.yaw_rate_rad_s, self.side_slip_rad, self.speed_m_s], axis=-1)

    @property
    def inputs(self) -> np.ndarray:
        """Steering and longitudinal acceleration (steps, 2), the control of that model."""
        return np.stack([self.steering_rad, self.longitudinal_acceleration_m_s2], axis=-1)
