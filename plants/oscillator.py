"""A lightly damped linear oscillator: the simplest plant, on which a UKF is the Kalman filter.

x'' = -w^2 x - g x' + white noise. It starts in its stationary law, which is also the prior.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.plants.damped_oscillation import (
    oscillation_noise_cov,
    oscillation_transition,
    stationary_cov,
)
from concord.plants.motion import require_positive
from concord.plants.placement import Draws, GeneratorFor, standard_draws


class Output(NamedTuple):
    """Output that a node measures: `row` (2,) times the state, with noise of `noise_std`."""

    row: tuple[float, float]
    noise_std: float


POSITION = Output((1.0, 0.0), 0.5)
VELOCITY = Output((0.0, 1.0), 0.5)


@dataclass(frozen=True)
class Oscillation:
    """A model; state [x, vx] in m and m/s.

    Raises:
        ValueError: for values that are not positive, or damping that prevents an oscillation.
    """

    time_step_s: float = 0.1
    frequency_rad_s: float = 1.0
    damping_1_s: float = 0.1
    velocity_std_m_s: float = 1.0  # in the long run

    def __post_init__(self) -> None:
        require_positive(velocity_std_m_s=self.velocity_std_m_s)
        _ = self.transition_matrix  # refuses the rest

    @cached_property
    def transition_matrix(self) -> np.ndarray:
        """Return the transition (2, 2)."""
        return oscillation_transition(self.frequency_rad_s, self.damping_1_s, self.time_step_s)

    @cached_property
    def stationary_cov(self) -> np.ndarray:
        """Covariance (2, 2) in the long run."""
        return stationary_cov(self.frequency_rad_s, self.velocity_std_m_s)

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """States (..., 2) -> (..., 2), one step later."""
        matrix = self.transition_matrix
        after = np.empty_like(state)
        after[..., 0] = matrix[0, 0] * state[..., 0] + matrix[0, 1] * state[..., 1]
        after[..., 1] = matrix[1, 0] * state[..., 0] + matrix[1, 1] * state[..., 1]
        return after

    def process_noise_cov(self, step: int) -> np.ndarray:
        """Covariance (2, 2) that the step adds."""
        return self._process_noise_cov

    @cached_property
    def _process_noise_cov(self) -> np.ndarray:
        return oscillation_noise_cov(self.transition_matrix, self.stationary_cov)


@dataclass(frozen=True, eq=False)
class ScalarSensor:
    """One number per node: `row` (2,) or (nodes, 2) times the state, `noise_std` () or (nodes,)."""

    row: np.ndarray
    noise_std: np.ndarray
    gate: float | None = None

    def for_node(self, node: int | np.ndarray) -> "ScalarSensor":
        """Return the sensor of one of the nodes, or of nodes (...) for states (..., 2)."""
        return replace(self, row=self.row[node], noise_std=self.noise_std[node])

    @property
    def channels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of a node's number; empty where it is neither position nor velocity."""
        names = {(1.0, 0.0): ("position", "m"), (0.0, 1.0): ("velocity", "m/s")}
        known = names.get(tuple(self.row.tolist())) if self.row.ndim == 1 else None
        return () if known is None else (known,)

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Return the number (..., 1) of states (..., 2), without noise."""
        value = self.row[..., 0] * state[..., 0] + self.row[..., 1] * state[..., 1]
        return value[..., None]

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., 1)."""
        return a - b

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the delivered (..., 1) as it is, and its noise covariance (..., 1, 1)."""
        noise_cov = (self.noise_std**2)[..., None, None]
        return delivered, np.broadcast_to(noise_cov, (*delivered.shape, 1))


@dataclass(frozen=True)
class Oscillator:
    """A plant: one oscillator seen by `nodes` nodes.

    `outputs` are dealt to the nodes in turn; None is a blind node. By default the nodes see
    position, velocity, position, nothing, position, velocity, position, nothing, ...

    Raises:
        ValueError: for no nodes, no outputs or noise that is not positive.
    """

    nodes: int = 8
    model: Oscillation = field(default_factory=Oscillation)
    outputs: tuple[Output | None, ...] = (POSITION, VELOCITY, POSITION, None)

    state_names = ("x", "vx")
    state_units = ("m", "m/s")

    def __post_init__(self) -> None:
        if self.nodes < 1 or not self.outputs:
            raise ValueError(
                f"oscillator with {self.nodes} nodes and {len(self.outputs)} outputs: "
                "give at least one of each"
            )
        for output in self.outputs:
            require_positive(noise_std=output.noise_std if output else 1.0)

    @property
    def time_step_s(self) -> float:
        return self.model.time_step_s

    @cached_property
    def sensors(self) -> ScalarSensor:
        """The sensors of all nodes. A blind one's row is irrelevant: nothing is delivered."""
        dealt = [self._output(node) or POSITION for node in range(self.nodes)]
        return ScalarSensor(
            row=np.array([output.row for output in dealt]),
            noise_std=np.array([output.noise_std for output in dealt]),
        )

    def sensor(self, node: int) -> ScalarSensor:
        """Return the sensor of one node."""
        return self.sensors.for_node(node)

    def positions(self, step: int) -> None:
        """The nodes have no place in the plane."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run."""
        return standard_draws(generator_for, 2, 2, (self.nodes, 1, 1), steps)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., 2), prior mean (..., 2) and prior cov (2, 2) for noise (..., 2)."""
        prior_cov = self.model.stationary_cov
        state = noise * np.sqrt(prior_cov.diagonal())
        return state, np.zeros_like(state), prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """True states (..., 2) one step later, for noise (..., 2)."""
        factor = np.linalg.cholesky(self.model.process_noise_cov(step))
        return self.model.transition(state, control, step) + noise @ factor.T

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the nodes' readings (..., nodes, 1, 1) of states (..., 2) for this noise."""
        exact = self.sensors.measure(state[..., None, :], step)
        delivered = exact + noise[..., 0, :] * self.sensors.noise_std[:, None]
        delivered[..., self._blind, :] = np.nan
        return delivered[..., None, :]

    def _output(self, node: int) -> Output | None:
        return self.outputs[node % len(self.outputs)]

    @cached_property
    def _blind(self) -> NDArray[np.bool_]:
        return np.array([self._output(node) is None for node in range(self.nodes)])
