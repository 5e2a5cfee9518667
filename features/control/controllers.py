"""Controllers as they run: values with a pure function from an estimate to a control.

Each has `initial_memory`, `reference(step)` and `control(state_estimate, memory, step)`, which
returns the control and the next memory. The estimate may be the true state or any node's belief.
Their design is elsewhere: what is here needs numpy alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.plants.linear import Signal


@dataclass(frozen=True, eq=False)
class StateFeedback:
    """u = N r - K x, clipped to [-limit, limit].

    gain: K (p, n); precompensation: N (p, r); signal: step -> (r,); limit: in units of u.
    """

    gain: np.ndarray
    precompensation: np.ndarray
    signal: Signal
    limit: float = np.inf

    @property
    def initial_memory(self) -> np.ndarray:
        return np.zeros(0)

    def reference(self, step: int) -> np.ndarray:
        return self.signal(step)

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimate (..., n) to control (..., p); nothing is remembered."""
        wanted = self.precompensation @ self.signal(step) - state_estimate @ self.gain.T
        return np.clip(wanted, -self.limit, self.limit), memory


@dataclass(frozen=True, eq=False)
class IntegralFeedback:
    """u = -K x - K_z z, where z sums (C x - r) over time.

    gain: K (p, n); integral_gain: K_z (p, r); output_row: C (r, n); signal: step -> (r,).
    The memory (..., r) is z, in output units times seconds.
    """

    gain: np.ndarray
    integral_gain: np.ndarray
    output_row: np.ndarray
    time_step_s: float
    signal: Signal

    @property
    def initial_memory(self) -> np.ndarray:
        return np.zeros(len(self.output_row))

    def reference(self, step: int) -> np.ndarray:
        return self.signal(step)

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimate (..., n) and integral (..., r) to control (..., p) and the next integral."""
        wanted = -state_estimate @ self.gain.T - memory @ self.integral_gain.T
        error = state_estimate @ self.output_row.T - self.signal(step)
        return wanted, memory + self.time_step_s * error


class Compensator(NamedTuple):
    """A sampled transfer function: z[k+1] = a z[k] + b e[k], u[k] = c z[k] + d e[k].

    state_matrix: a (m, m); input_column: b (m, 1); output_row: c (1, m); feedthrough: d (1, 1).
    """

    state_matrix: np.ndarray
    input_column: np.ndarray
    output_row: np.ndarray
    feedthrough: np.ndarray


@dataclass(frozen=True, eq=False)
class OutputFeedback:
    """A classical controller: a compensator fed with e = r - C x.

    output_row: C (1, n); signal: step -> (1,). The memory (..., m) is the compensator's state.
    """

    compensator: Compensator
    output_row: np.ndarray
    signal: Signal

    @property
    def initial_memory(self) -> np.ndarray:
        return np.zeros(len(self.compensator.state_matrix))

    def reference(self, step: int) -> np.ndarray:
        return self.signal(step)

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimate (..., n) and memory (..., m) to control (..., 1) and the next memory."""
        a, b, c, d = self.compensator
        error = self.signal(step) - state_estimate @ self.output_row.T
        wanted = memory @ c.T + error @ d.T
        return wanted, memory @ a.T + error @ b.T
