"""The example of Meng et al. (2025): two states, six scalar sensors, stochastic nonlinearities.

Source: section 4 of the paper. f takes the time of the state it moves, h that of the state it sees.
The paper says where the estimate starts and not where the state does: here in the prior.
"""

import numpy as np

from concord.features.measurement_bus.sensed import SensedPlant, SensorPlacement
from concord.features.measurement_bus.stochastic import (
    StochasticNonlinearity,
    StochasticSystem,
    Term,
)

STATES, SENSORS = 2, 6
STATIC_SLOTS = 4
PRIOR_MEAN = np.array([5.0, -2.0])
PRIOR_COV = np.eye(STATES)

_PROCESS_NOISE_COV = 0.05 * np.eye(STATES)
_MEASUREMENT_NOISE_COV = 0.01 * np.eye(SENSORS)
_INNER = np.diag([0.2, 0.3])
_PROCESS = StochasticNonlinearity(STATES, STATES, (Term(np.array([[0.3], [0.2]]), _INNER),))
_MEASUREMENT = StochasticNonlinearity(
    SENSORS, STATES, (Term(np.array([[0.3], [0.2], [0.1], [0.1], [0.2], [0.3]]), _INNER),)
)


def transition(state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
    """f: states (..., 2) at `step` to the next, without noise."""
    first, second = state[..., 0], state[..., 1]
    after = np.empty_like(state)
    after[..., 0] = (0.58 + 0.3 * np.cos(step)) * first + 0.39 * second
    after[..., 1] = (0.28 + 0.2 * np.sin(step)) * first + 0.52 * second
    return after


def measure(state: np.ndarray, step: int) -> np.ndarray:
    """h: measurements (..., 6) of states (..., 2) at `step`, without noise."""
    first, second = state[..., 0], state[..., 1]
    product = first * second
    seen = np.empty((*state.shape[:-1], SENSORS))
    seen[..., 0] = 0.36 * first + second * second
    seen[..., 1] = product + 0.16 * second
    seen[..., 2] = 0.8 * np.cos(step) * first + 0.36 * second
    seen[..., 3] = 0.5 * first + product
    seen[..., 4] = 0.7 * np.cos(step) * first + 0.8 * second
    seen[..., 5] = 0.3 * first + 0.8 * np.sin(step) * second
    return seen


SYSTEM = StochasticSystem(
    transition=transition,
    measure=measure,
    sizes=(1,) * SENSORS,
    process_noise_cov=lambda _: _PROCESS_NOISE_COV,
    measurement_noise_cov=lambda _: _MEASUREMENT_NOISE_COV,
    process=lambda _: _PROCESS,
    measurement=lambda _: _MEASUREMENT,
)


def plant(placement: SensorPlacement) -> SensedPlant:
    """The example with its sensors placed at nodes; the paper gives neither units nor time."""
    return SensedPlant(SYSTEM, PRIOR_MEAN, PRIOR_COV, ("x1", "x2"), ("1", "1"), placement)
