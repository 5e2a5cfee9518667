"""A system with stochastic nonlinearities as a plant: its sensors on one bus, or at every node.

Truth starts in the prior, at step 0; sensors measure from step 1 on. Every sensor's noise comes
from a stream of its own; the numbers of b, which the sensors of a system share, from another.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.stochastic import StochasticSystem
from concord.plants.placement import Draws, GeneratorFor

SHARED = "shared measurement"


class SensorPlacement(NamedTuple):
    """Which node has which sensors.

    Attributes:
        nodes: how many nodes there are.
        draw: (system, generator_for, steps) -> noise (steps, ...) of all measurements.
        observe: (system, states (..., n), noise of one step, step) -> what the nodes read, (...,
            nodes, 1, d), filled up with NaN.
    """

    nodes: int
    draw: Callable[[StochasticSystem, GeneratorFor, int], np.ndarray]
    observe: Callable[[StochasticSystem, np.ndarray, np.ndarray, int], np.ndarray]


@dataclass(frozen=True, eq=False)
class SensedPlant:
    """The plant: prior_mean (n,) and prior_cov (n, n) are where truth starts."""

    system: StochasticSystem
    prior_mean: np.ndarray
    prior_cov: np.ndarray
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    placement: SensorPlacement
    time_step_s: float = 1.0

    def positions(self, step: int) -> None:
        """The nodes have no place in the plane."""

    def draw(self, generator_for: GeneratorFor, steps: int) -> Draws:
        """Return the noise of one run: process (steps, n + numbers of g), measurement as placed."""
        n = len(self.prior_mean)
        numbers = n + self.system.process(0).numbers
        return Draws(
            generator_for("initial", 0).standard_normal(n),
            generator_for("process", 0).standard_normal((steps, numbers)),
            self.placement.draw(self.system, generator_for, steps),
        )

    def initial(self, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """True state (..., n), prior mean (..., n) and prior cov (n, n) for noise (..., n)."""
        state = self.prior_mean + noise @ np.linalg.cholesky(self.prior_cov).T
        return state, np.broadcast_to(self.prior_mean, state.shape), self.prior_cov

    def advance(
        self, state: np.ndarray, control: np.ndarray | None, noise: np.ndarray, step: int
    ) -> np.ndarray:
        """True states (..., n) one step later."""
        return self.system.advance(state, control, noise, step)

    def observe(self, state: np.ndarray, noise: np.ndarray, step: int) -> np.ndarray:
        """Return the nodes' readings (..., nodes, 1, d); NaN without a reading, as at step 0."""
        delivered = self.placement.observe(self.system, state, noise, step)
        return delivered if step > 0 else np.full_like(delivered, np.nan)


def sensors_on_a_bus(sensors: int) -> SensorPlacement:
    """Node 0 estimates and has no sensor, nodes 1..N are the sensors."""
    return SensorPlacement(1 + sensors, partial(draw_sensors, first=1), _one_sensor_each)


def clusters(nodes: int) -> SensorPlacement:
    """All sensors of the system at each node, independent of those at others.

    Raises:
        ValueError: for no nodes.
    """
    if nodes < 1:
        raise ValueError(f"sensor clusters at {nodes} nodes: give at least one")
    return SensorPlacement(nodes, partial(_draw_clusters, nodes=nodes), _all_sensors_each)


def draw_sensors(
    system: StochasticSystem, generator_for: GeneratorFor, steps: int, first: int
) -> np.ndarray:
    """Noise (steps, m + numbers of b) of the sensors of a system, numbered from `first` on."""
    own = [
        generator_for("measurement", first + place).standard_normal((steps, size))
        for place, size in enumerate(system.sizes)
    ]
    shared = generator_for(SHARED, first).standard_normal((steps, system.measurement(0).numbers))
    return np.concatenate([*own, shared], axis=-1)


def _draw_clusters(
    system: StochasticSystem, generator_for: GeneratorFor, steps: int, nodes: int
) -> np.ndarray:
    sensors = len(system.sizes)
    return np.stack(
        [draw_sensors(system, generator_for, steps, 1 + node * sensors) for node in range(nodes)],
        axis=1,
    )


def _one_sensor_each(
    system: StochasticSystem, state: np.ndarray, noise: np.ndarray, step: int
) -> np.ndarray:
    measured = system.observe(state, noise, step)
    ends = np.cumsum(system.sizes)[:-1]
    nodes = 1 + len(system.sizes)
    delivered = np.full((*measured.shape[:-1], nodes, 1, max(system.sizes)), np.nan)
    for sensor, values in enumerate(np.split(measured, ends, axis=-1), start=1):
        delivered[..., sensor, 0, : values.shape[-1]] = values
    return delivered


def _all_sensors_each(
    system: StochasticSystem, state: np.ndarray, noise: np.ndarray, step: int
) -> np.ndarray:
    return system.observe(state[..., None, :], noise, step)[..., None, :]
