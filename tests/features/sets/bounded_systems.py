"""Random bounded plants over a FlexRay measurement bus, and noise as bad as the bounds allow."""

from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st

from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.delivered import bus_of_outputs, delivered
from concord.features.sets.filters.bus_readings import MeasuredPlant
from concord.features.sets.filters.lifted_cycle import DeliveredValues, WeightsAtStep

STEPS = 12


class Sizes(NamedTuple):
    """n states, m outputs of which l are sent in turn, q noises."""

    states: int
    outputs: int
    static: int
    noises: int


@st.composite
def sizes(draw: st.DrawFn, contending: int = 0) -> Sizes:
    """Small plants in which so many outputs at least contend."""
    outputs = draw(st.integers(max(1, contending), 4))
    static = draw(st.integers(0, outputs - contending))
    return Sizes(draw(st.integers(1, 3)), outputs, static, draw(st.integers(1, 2)))


def random_plant(
    rng: np.random.Generator, of: Sizes, steps: int = STEPS
) -> MeasuredPlant[BoundedSystem]:
    """Time-varying matrices of a plant that may be unstable, each step drawn by itself."""
    n, m, static, q = of
    transition = rng.standard_normal((steps, n, n)) * rng.uniform(0.3, 1.1) / np.sqrt(n)
    noise_input = 0.3 * rng.standard_normal((steps, n, q))
    output = rng.standard_normal((steps, m, n))
    feedthrough = 0.3 * rng.standard_normal((steps, m, q))
    factors = rng.standard_normal((steps, q, q)) + 2.0 * np.eye(q)
    weights = rng.uniform(0.5, 2.0, (steps, m - static))
    system = BoundedSystem(
        transition=lambda k: transition[k],
        noise_input=lambda k: noise_input[k],
        output=lambda k: output[k],
        feedthrough=lambda k: feedthrough[k],
        noise_shape=lambda k: factors[k] @ factors[k].T,
    )
    return MeasuredPlant(system, static, lambda k: weights[k])


def transmit(outputs: np.ndarray, static_outputs: int, weights: WeightsAtStep) -> DeliveredValues:
    """Outputs (..., steps, m) over the measurement bus."""
    bus = bus_of_outputs(outputs.shape[-1], static_outputs, weights)
    return delivered(bus, static_outputs, outputs)


def on_the_sphere(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Unit vectors along the last axis: the ends of an interval where it is one long."""
    vectors = rng.standard_normal(shape)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def run_of(
    rng: np.random.Generator, plant: MeasuredPlant[BoundedSystem], lanes: int, cycles: int
) -> tuple[np.ndarray, DeliveredValues]:
    """States (lanes, steps + 1, n) from the edge of the unit ball under noise on its bound."""
    n, q = plant.system.noise_input(0).shape
    noise = on_the_sphere(rng, lanes, cycles * plant.length, q)
    states, outputs = plant.system.simulate(on_the_sphere(rng, lanes, n), noise)
    return states, transmit(outputs, plant.static_outputs, plant.weights)
