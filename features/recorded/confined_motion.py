"""A model of a robot that wanders about a hall: each axis is a damped oscillation about its centre.

x'' = -w^2 (x - c) - x'/tau + white noise of spectral density 2 sv^2 / tau. Other than constant
velocity it does not drift away while no node sees it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from concord.plants.damped_oscillation import (
    oscillation_noise_cov,
    oscillation_transition,
    stationary_cov,
)

_AXES = ([0, 2], [1, 3])  # position and velocity of x, of y


@dataclass(frozen=True)
class ConfinedMotion:
    """State [px, py, vx, vy] in m and m/s. The defaults fit robots in the MRCLAM hall.

    Raises:
        ValueError: for values that are not positive, or damping that prevents an oscillation.
    """

    time_step_s: float = 0.2
    centre_m: tuple[float, float] = (2.2, 0.2)
    frequency_rad_s: tuple[float, float] = (0.045, 0.022)
    velocity_time_constant_s: float = 30.0
    velocity_std_m_s: float = 0.042

    def __post_init__(self) -> None:
        _ = self.transition_matrix  # refuses what does not fit

    @cached_property
    def transition_matrix(self) -> np.ndarray:
        """Return the transition (4, 4) of what departs from the stationary mean."""
        matrix = np.zeros((4, 4))
        for axis, frequency in zip(_AXES, self.frequency_rad_s, strict=True):
            matrix[np.ix_(axis, axis)] = oscillation_transition(
                frequency, 1 / self.velocity_time_constant_s, self.time_step_s
            )
        return matrix

    @cached_property
    def stationary_mean(self) -> np.ndarray:
        """Mean (4,) in the long run."""
        return np.array([*self.centre_m, 0.0, 0.0])

    @cached_property
    def stationary_cov(self) -> np.ndarray:
        """Covariance (4, 4) in the long run."""
        cov = np.zeros((4, 4))
        for axis, frequency in zip(_AXES, self.frequency_rad_s, strict=True):
            cov[np.ix_(axis, axis)] = stationary_cov(frequency, self.velocity_std_m_s)
        return cov

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., 4) -> (..., 4), one step later."""
        matrix = self.transition_matrix
        after = np.empty_like(state)
        for (position, velocity), centre in zip(_AXES, self.centre_m, strict=True):
            departure, rate = state[..., position] - centre, state[..., velocity]
            after[..., position] = (
                centre + matrix[position, position] * departure + matrix[position, velocity] * rate
            )
            after[..., velocity] = (
                matrix[velocity, position] * departure + matrix[velocity, velocity] * rate
            )
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (4, 4) that the step adds."""
        return self._process_noise_cov

    @cached_property
    def _process_noise_cov(self) -> np.ndarray:
        return oscillation_noise_cov(self.transition_matrix, self.stationary_cov)
