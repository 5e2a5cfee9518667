"""The example of Liu et al. (2021): four states, one of them unstable, four outputs, one noise.

Source: section VI. Time is counted in steps (T_k = k). The first two outputs are sent in turn, the
other two contend. The printed bound W = 10 on the noise is a hundred times as large as what the
printed noise 0.3 sin(-T) needs; |w| may be up to 3.16.
"""

import numpy as np

from plants.bounded import BoundedSystem
from plants.draws import Array

STATES, OUTPUTS, STATIC_OUTPUTS = 4, 4, 2
STEPS = 39
INITIAL_STATE = np.array([0.15, 0.16, 0.1, -0.2])
NOISE_BOUND = np.sqrt(10.0)


def transition(step: int) -> Array:
    """A (4, 4)."""
    return np.array(
        [
            [1.19 + 0.2 * np.sin(10 * step), 0.25, 0.0, 0.0],
            [-0.1, 0.16 - 0.2 * np.cos(2 * step), 0.0, 0.0],
            [0.2, 0.0, -0.8, -0.1 * np.sin(4 * step)],
            [0.0, 0.0, 0.1, 1.0],
        ]
    )


def noise_input(step: int) -> Array:
    """B (4, 1)."""
    first, second = 0.13 + 0.2 * np.sin(10 * step), 0.15 - 0.2 * np.cos(2 * step)
    return np.array([[first], [second], [0.2], [-0.15]])


def output(step: int) -> Array:
    """C (4, 4)."""
    return np.diag([9 + 0.3 * np.cos(-2 * step), 1.8 - 0.1 * np.cos(3 * step), 6.0, 8.0])


def feedthrough(step: int) -> Array:
    """D (4, 1)."""
    return np.array([[0.12], [0.17 + 0.27 * np.cos(step)], [0.2], [-0.2]])


def weights(step: int) -> Array:
    """Q_3 and Q_4 (2,), of the outputs that contend."""
    return np.array([2.0, 1.0])


def printed_noise(steps: int) -> Array:
    """w = 0.3 sin(-T) (steps, 1) in units of its bound."""
    return 0.3 * np.sin(-np.arange(steps, dtype=float))[:, None] / NOISE_BOUND


SYSTEM = BoundedSystem(
    transition=transition,
    noise_input=noise_input,
    output=output,
    feedthrough=feedthrough,
    noise_shape=lambda _: np.array([[10.0]]),
)
