"""How a target moves in the plane, and what a filter may believe of it.

A motion is a model: `transition` carries states (..., n) by one step, `process_noise_cov` is what
the step adds. Functions of the state keep its memory layout (`numpy.empty_like`) and every leading
axis. The control is ignored: targets have a will of their own.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np


def require_positive(**values: float) -> None:
    """Raises ValueError for the first value that is not above 0 and finite, by its name."""
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} is {value}, but must be above 0 and finite; change {name}")


TURN_RATE = 4
"""Place of the rate of turn in the state of `CoordinatedTurn`."""
_RATE_FLOOR_RAD_S = 1e-6


class Motion(Protocol):
    """A model of motion whose state begins with [x, vx, y, vy] in m and m/s."""

    @property
    def time_step_s(self) -> float: ...
    @property
    def state_names(self) -> tuple[str, ...]: ...
    @property
    def state_units(self) -> tuple[str, ...]: ...
    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., n) -> (..., n), one step later."""
        ...

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) that the step adds."""
        ...


@dataclass(frozen=True)
class ConstantVelocity:
    """A straight line disturbed by white acceleration; state [x, vx, y, vy] (Bar-Shalom, Li and
    Kirubarajan 2001, section 6.2.2).

    Raises:
        ValueError: for a step or density that is not positive.
    """

    time_step_s: float = 1.0
    acceleration_density_m2_s3: float = 0.05

    state_names = ("x", "vx", "y", "vy")
    state_units = ("m", "m/s", "m", "m/s")

    def __post_init__(self) -> None:
        require_positive(
            time_step_s=self.time_step_s,
            acceleration_density_m2_s3=self.acceleration_density_m2_s3,
        )

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., 4) -> (..., 4), one step later."""
        after = np.empty_like(state)
        velocities = after[..., 1::2] = state[..., 1::2]
        # In place, as many lanes take as long as it takes to pass over their memory.
        positions = np.multiply(velocities, self.time_step_s, out=after[..., ::2])
        positions += state[..., ::2]
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (4, 4) of the integrated white acceleration over a step."""
        return self._process_noise_cov

    @cached_property
    def _process_noise_cov(self) -> np.ndarray:
        return _plane_noise(self.time_step_s, self.acceleration_density_m2_s3)


@dataclass(frozen=True)
class CoordinatedTurn:
    """A circle at constant speed whose rate of turn w wanders; state [x, vx, y, vy, w].

    The transition is the exact solution for constant w (Bar-Shalom, Li and Kirubarajan 2001,
    section 11.7.1). A rate below 1e-6 rad/s in size is moved as 1e-6 rad/s.

    Raises:
        ValueError: for a step, density or deviation that is not positive.
    """

    time_step_s: float = 1.0
    acceleration_density_m2_s3: float = 0.05
    turn_rate_drift_rad_s: float = 1e-3  # standard deviation that the rate gains in one second

    state_names = ("x", "vx", "y", "vy", "w")
    state_units = ("m", "m/s", "m", "m/s", "rad/s")

    def __post_init__(self) -> None:
        require_positive(
            time_step_s=self.time_step_s,
            acceleration_density_m2_s3=self.acceleration_density_m2_s3,
            turn_rate_drift_rad_s=self.turn_rate_drift_rad_s,
        )

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., 5) -> (..., 5), one step later."""
        vx, vy, rate = state[..., 1], state[..., 3], state[..., 4]
        moving_rate = np.where(np.abs(rate) < _RATE_FLOOR_RAD_S, _RATE_FLOOR_RAD_S, rate)
        # Sine and 1 - cosine from one tangent: the step takes a third of the time that numpy's sin
        # and cos need, and nothing cancels at small angles.
        tangent = np.tan((0.5 * self.time_step_s) * moving_rate)
        sine = 2 * tangent / (1 + tangent * tangent)
        versine = tangent * sine
        along, across = sine / moving_rate, versine / moving_rate
        after = np.empty_like(state)
        after[..., 0] = state[..., 0] + along * vx - across * vy
        after[..., 1] = vx - versine * vx - sine * vy
        after[..., 2] = state[..., 2] + across * vx + along * vy
        after[..., 3] = vy - versine * vy + sine * vx
        after[..., 4] = rate
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (5, 5): white acceleration on both axes, a random walk of the rate."""
        return self._process_noise_cov

    @cached_property
    def _process_noise_cov(self) -> np.ndarray:
        cov = np.zeros((5, 5))
        cov[:4, :4] = _plane_noise(self.time_step_s, self.acceleration_density_m2_s3)
        cov[4, 4] = self.turn_rate_drift_rad_s**2 * self.time_step_s
        return cov


def _plane_noise(time_step_s: float, density: float) -> np.ndarray:
    """Covariance (4, 4) of [x, vx, y, vy] after a step under white acceleration of this density."""
    dt = time_step_s
    cov = np.zeros((4, 4))
    cov[:2, :2] = cov[2:, 2:] = [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]
    return density * cov
