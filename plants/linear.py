"""Linear plants, what filters believe about them, and the sensors that watch them.

    x[k+1] = F x[k] + G u[k] + drift[k] + E w[k],   y[k] = H_i x[k] + std_i v[k] at node i

with standard normal w and v. Continuous descriptions and their sampling are elsewhere: what is
here needs numpy alone, so that a node can hold it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.plants.placement import Draws, GeneratorFor, standard_draws

Signal = Callable[[int], np.ndarray]


class Drift(NamedTuple):
    """A deterministic input that no controller commands, such as the height of the road.

    matrix: (n, r), the sampled input matrix; signal: step -> (r,).
    """

    matrix: np.ndarray
    signal: Signal

    def __call__(self, step: int) -> np.ndarray:
        """Return the input's contribution to the state between step and step + 1: (n,)."""
        return self.matrix @ self.signal(step)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Model of a filter: F (n, n), G (n, p), Q (n, n), and the known drift."""

    transition_matrix: np.ndarray
    control_matrix: np.ndarray
    noise_cov: np.ndarray
    drift: Drift | None = None

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., n) at step to step + 1, without noise; control (..., p), None for none."""
        moved = state @ self.transition_matrix.T
        if control is not None:
            moved = moved + control @ self.control_matrix.T
        return moved if self.drift is None else moved + self.drift(step)

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (n, n) of what the transition leaves out; the same at every step."""
        return self.noise_cov


@dataclass(frozen=True, eq=False)
class LinearSensor:
    """Sensor of a node: rows (..., m, n) of the state, with standard deviations (..., m).

    A leading axis, if present, counts the nodes. A NaN in noise_std means that the node has no
    sensor for that row.
    """

    rows: np.ndarray
    noise_std: np.ndarray
    gate: None = None

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """State (..., n) to the noiseless measurement (..., m)."""
        return (self.rows * state[..., None, :]).sum(-1)

    def residual(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """left - right (..., m): no entry is an angle that wraps."""
        return left - right

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Delivered (..., m) to value (..., m) and noise covariance (..., m, m).

        A blind entry stays NaN, missing; its variance is set to 1 and means nothing.
        """
        variances = np.where(np.isnan(self.noise_std), 1.0, self.noise_std**2)
        noise_cov = variances[..., None] * np.eye(variances.shape[-1])
        return delivered, np.broadcast_to(noise_cov, (*delivered.shape, delivered.shape[-1]))


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """The truth: a linear model, the noise and the drift it really has, and a sensor per node.

    model: what filters believe; the truth shares F, G and the model's drift with it.
    noise_factor: E (n, q). Its E E' equals model.noise_cov unless `warning` says otherwise.
    sensors: of all nodes, rows (nodes, d, n) and noise_std (nodes, d).
    initial_state: (n,) of the truth; prior_cov: (n, n) of the belief that all nodes start from.
    unknown_drift: a drift that the truth has and no filter knows.
    warning: what a user must be told before trusting a filter that believes `model`.
    """

    name: str
    time_step_s: float
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    model: LinearModel
    noise_factor: np.ndarray
    sensors: LinearSensor
    initial_state: np.ndarray
    prior_cov: np.ndarray
    unknown_drift: Drift | None = None
    warning: str = ""

    position_states = None

    @property
    def nodes(self) -> int:
        return len(self.sensors.rows)

    def sensor(self, node: int) -> LinearSensor:
        """Return the sensor of one node."""
        return LinearSensor(self.sensors.rows[node], self.sensors.noise_std[node])

    def positions(self, step: int) -> None:
        """These sensors sit in one machine: nothing to draw on a map."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run."""
        nodes, outputs = self.sensors.noise_std.shape
        n, q = self.noise_factor.shape
        return standard_draws(generator_for, n, q, (nodes, 1, outputs), steps)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Standard normals (..., n) to truth (..., n), prior mean (..., n), prior cov (n, n).

        The prior mean is truth + N(0, prior_cov), one for all nodes.
        """
        error = noise @ np.linalg.cholesky(self.prior_cov).T
        state = np.broadcast_to(self.initial_state, error.shape)
        return state, state + error, self.prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """The truth (..., n) from step to step + 1 under control (..., p), normals (..., q)."""
        moved = self.model.transition(state, control, step) + noise @ self.noise_factor.T
        return moved if self.unknown_drift is None else moved + self.unknown_drift(step)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """State (..., n), normals (..., nodes, 1, d) to delivered (..., nodes, 1, d).

        NaN where a node is blind.
        """
        exact = self.sensors.measure(state[..., None, :], step)
        return exact[..., None, :] + self.sensors.noise_std[:, None, :] * noise
