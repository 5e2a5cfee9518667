"""A node's model of a system with stochastic nonlinearities: its noise grows with the state."""

from dataclasses import dataclass

import numpy as np

from concord.features.measurement_bus.stochastic import StochasticSystem
from concord.features.measurement_bus.stochastic_ukf import expected_cov
from concord.filters.gaussian import Gaussian


@dataclass(frozen=True, eq=False)
class SystemModel:
    """f, Q and E{g g'} of a system."""

    system: StochasticSystem

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., n) at `step + 1` from the state at `step`."""
        return self.system.transition(state, control, step)

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Q (n, n) of the step."""
        return self.system.process_noise_cov(step)

    def state_noise_cov(self, belief: Gaussian, step: int) -> np.ndarray:
        """E{g g'} (..., n, n) over beliefs at `step`."""
        return expected_cov(self.system.process_moment(step), belief)


@dataclass(frozen=True, eq=False)
class SystemSensor:
    """Some rows of h, R and E{b b'} of a system whose R does not vary.

    A delivered reading is the measurement of those rows, NaN where none was transmitted.
    """

    system: StochasticSystem
    rows: slice
    gate: None = None

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """The measurement (..., m) of a state (..., n), without noise."""
        return self.system.measure(state, step)[..., self.rows]

    def residual(self, value: np.ndarray, predicted: np.ndarray) -> np.ndarray:
        """value - predicted (..., m)."""
        return value - predicted

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first m entries (..., m) of what was delivered, and R (m, m)."""
        noise_cov = self.system.measurement_noise_cov(0)[self.rows, self.rows]
        return delivered[..., : len(noise_cov)], noise_cov

    def state_noise_cov(self, belief: Gaussian, step: int) -> np.ndarray:
        """E{b b'} (..., m, m) over beliefs at `step`."""
        every_row = expected_cov(self.system.measurement_moment(step), belief)
        return every_row[..., self.rows, self.rows]
