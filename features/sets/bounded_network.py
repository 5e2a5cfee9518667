"""A bounded plant with sensors in a network: every node reads one output, in turn.

The truth, what set-membership filters know of it (A, B and the bounds), and what Gaussian filters
may believe of it: noise whose covariance is the shape of its bound.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from concord.features.sets.bounded import BoundedSystem
from concord.plants.placement import Draws, GeneratorFor

_NO_NOISE = np.zeros(1)


@dataclass(frozen=True, eq=False)
class BoundedNetworkModel:
    """Model of the filters: the system, and how a known control (p,) enters, by G (n, p)."""

    system: BoundedSystem
    control_matrix: np.ndarray

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., n) at step to step + 1, without noise."""
        moved = state @ self.system.transition(step).T
        return moved if control is None else moved + control @ self.control_matrix.T

    def motion(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """A (n, n) and B (n, q) for noise in units of its bound."""
        return self.system.transition(step), self.system.scaled_noise_input(step)

    def process_noise_cov(self, step: int) -> np.ndarray:
        """B W B' (n, n), for filters that know covariances only."""
        noise = self.system.scaled_noise_input(step)
        return noise @ noise.T


@dataclass(frozen=True, eq=False)
class OutputSensor:
    """Sensor of a node: it reads one output of the system; `noise_bound` is its largest
    disturbance."""

    system: BoundedSystem
    output: int
    noise_bound: float
    gate: None = None

    def bounded_rows(self, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return C (1, n), D (1, q) and 0 (1,): only the noise of the plant disturbs a reading."""
        rows = [self.output]
        return self.system.output(step)[rows], self.system.scaled_feedthrough(step)[rows], _NO_NOISE

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """State (..., n) to the undisturbed reading (..., 1)."""
        return state @ self.system.output(step)[self.output][:, None]

    def residual(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """left - right (..., 1)."""
        return left - right

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value (..., 1), and the squared bound as a variance, for filters that know those only."""
        cov = np.full((1, 1), self.noise_bound**2)
        return delivered, np.broadcast_to(cov, (*delivered.shape, 1))


@dataclass(frozen=True, eq=False)
class BoundedNetwork:
    """The truth and its sensors.

    noise_bounds: (m,), the largest disturbance of each output.
    prior_shape: (n, n), the shape of the ellipsoid about zero that holds the initial state.
    noise: (generator, steps) -> (steps, q), in units of its bound.
    start: standard normals (n,) -> the initial state in units of the prior, at most 1 long.
    """

    system: BoundedSystem
    model: BoundedNetworkModel
    nodes: int
    noise_bounds: np.ndarray
    prior_shape: np.ndarray
    noise: Callable[[np.random.Generator, int], np.ndarray]
    start: Callable[[np.ndarray], np.ndarray]
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    time_step_s: float = 1.0

    def sensor(self, node: int) -> OutputSensor:
        """Outputs are dealt out in turn."""
        output = node % len(self.noise_bounds)
        return OutputSensor(self.system, output, float(self.noise_bounds[output]))

    def positions(self, step: int) -> None:
        """The nodes have no place in the plane."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run: the same for the state and for every sensor."""
        process = self.noise(generator_for("process", 0), steps)
        everywhere = np.broadcast_to(
            process[:, None, None], (steps, self.nodes, 1, process.shape[-1])
        )
        initial = generator_for("initial", 0).standard_normal(len(self.prior_shape))
        return Draws(initial, process, np.array(everywhere))

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (n,), and centre (n,) and shape (n, n) of the ellipsoid that holds it."""
        state = np.linalg.cholesky(self.prior_shape) @ self.start(noise)
        return state, np.zeros_like(state), self.prior_shape

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """States (..., n) one step later, under noise (..., q)."""
        moved = self.model.transition(state, control, step)
        return moved + noise @ self.system.scaled_noise_input(step).T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the nodes' readings (..., nodes, 1, 1) of state (..., n), noise (..., nodes, 1,
        q)."""
        dealt = np.arange(self.nodes) % len(self.noise_bounds)
        exact = state @ self.system.output(step)[dealt].T
        disturbance = self.system.scaled_feedthrough(step)[dealt][:, None]
        return (exact[..., None] + (noise * disturbance).sum(-1))[..., None]


def on_the_bound(generator: np.random.Generator, steps: int, size: int) -> np.ndarray:
    """Noise (steps, size) as large as its bound allows, in random directions."""
    directions = generator.standard_normal((steps, size))
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
