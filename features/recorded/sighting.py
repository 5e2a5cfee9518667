"""A sensor on a robot of known pose that sights another robot by camera."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sighting:
    """Range and bearing from a known pose, taken as a measurement of the target's position.

    A delivered reading is (range m, bearing rad, px m, py m, heading rad): the observer's pose with
    what its camera says. The defaults fit the MRCLAM cameras, whose error of range is a bias per
    encounter rather than white noise.
    """

    range_bias_m: float = 0.031
    range_std_m: float = 0.1
    range_std_per_m: float = 0.1
    bearing_std_rad: float = 0.02
    gate: float | None = 11.0  # greatest normalised innovation squared: misread barcodes fail it

    channels = (("position x", "m"), ("position y", "m"))

    @property
    def delivered_std(self) -> np.ndarray:
        """Standard deviations (2,) of range at no distance, in m, and bearing, in rad."""
        return np.array([self.range_std_m, self.bearing_std_rad])

    def for_node(self, node: int | np.ndarray) -> "Sighting":
        """Return the same for every node: the reading itself carries the observer's pose."""
        return self

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Position (..., 2) of states (..., n) that begin with it."""
        return state[..., :2]

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., 2)."""
        return a - b

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position (..., 2) and its noise covariance (..., 2, 2) of readings (..., 5).

        Where any entry is NaN the position is NaN and the covariance finite.
        """
        missing = np.isnan(delivered).any(axis=-1, keepdims=True)
        read = np.where(missing, 1.0, delivered)
        distance = read[..., 0] - self.range_bias_m
        direction = read[..., 4] + read[..., 1]
        along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        position = read[..., 2:4] + distance[..., None] * along
        along_var = self.range_std_m**2 + (self.range_std_per_m * distance) ** 2
        across_var = (self.bearing_std_rad * distance) ** 2
        noise_cov = _scaled_outer(along_var, along) + _scaled_outer(across_var, across)
        return np.where(missing, np.nan, position), noise_cov


def _scaled_outer(variance: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """variance (...) times u u' (..., 2, 2) of directions u (..., 2)."""
    return variance[..., None, None] * (direction[..., :, None] * direction[..., None, :])
