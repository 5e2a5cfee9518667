"""A bounded plant whose scalar outputs are the sensors 1..m of a measurement bus."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from concord.features.measurement_bus.stochastic import StochasticNonlinearity, StochasticSystem
from concord.features.sets.bounded import BoundedSystem
from concord.plants.placement import Draws, GeneratorFor


@dataclass(frozen=True, eq=False)
class BoundedOnBus:
    """The truth; node 0 has no sensor, and node j reads output j.

    Attributes:
        system: the plant, with m outputs.
        prior_mean, prior_shape: (n,) and (n, n), the ellipsoid that holds the state at step 0.
        noise: (generator, steps) -> (steps, q), in units of its bound; it drives the state and
            disturbs the outputs.
        start: standard normals (n,) -> the first state in units of the prior, at most 1 long.
        state_names, state_units: of each state.
    """

    system: BoundedSystem
    prior_mean: np.ndarray
    prior_shape: np.ndarray
    noise: Callable[[np.random.Generator, int], np.ndarray]
    start: Callable[[np.ndarray], np.ndarray]
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    time_step_s: float = 1.0

    def positions(self, step: int) -> None:
        """The nodes have no place in the plane."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run: the same for the state and for every sensor."""
        noise = self.noise(generator_for("process", 0), steps)
        initial = generator_for("initial", 0).standard_normal(len(self.prior_mean))
        return Draws(initial, noise, noise)

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (n,), and centre (n,) and shape (n, n) of the ellipsoid that holds it."""
        values, vectors = np.linalg.eigh(self.prior_shape)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return self.prior_mean + root @ self.start(noise), self.prior_mean, self.prior_shape

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """States (..., n) one step later, under noise (..., q)."""
        return self.system.advance(state, noise, step)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the nodes' readings (..., 1 + m, 1, 1); NaN at node 0."""
        outputs = self.system.observe(state, noise, step)
        nobody = np.full((*outputs.shape[:-1], 1), np.nan)
        return np.concatenate([nobody, outputs], axis=-1)[..., None, None]


def inside(direction: np.ndarray) -> np.ndarray:
    """Return the direction (n,), as long as the unit ball allows."""
    return direction / np.linalg.norm(direction)


def as_gaussian(system: BoundedSystem, states: int) -> StochasticSystem:
    """The system as Gaussian filters may see it: covariances with the shapes of the bounds.

    The noise of the outputs counts as independent of each other and of that of the state.
    """
    outputs = len(system.output(0))

    def process_cov(step: int) -> np.ndarray:
        noise = system.scaled_noise_input(step)
        return noise @ noise.T

    def nothing(size: int) -> StochasticNonlinearity:
        return StochasticNonlinearity(size, states)

    return StochasticSystem(
        transition=lambda state, control, step: state @ system.transition(step).T,
        measure=lambda state, step: state @ system.output(step).T,
        sizes=(1,) * outputs,
        process_noise_cov=process_cov,
        measurement_noise_cov=lambda step: np.diag((system.scaled_feedthrough(step) ** 2).sum(-1)),
        process=lambda _: nothing(states),
        measurement=lambda _: nothing(outputs),
    )
