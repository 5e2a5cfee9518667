"""The example of Liu et al. (2021): four states, one of them unstable, four outputs, one noise.

Source: section VI. Time is counted in steps (T_k = k). The first two outputs are sent in turn, the
other two contend. The printed bound W = 10 on the noise is a hundred times as large as what the
printed noise 0.3 sin(-T) needs; |w| may be up to 3.16.
"""

from functools import partial

import numpy as np

from concord.features.sets.bounded import BoundedSystem
from concord.features.sets.bounded_network import BoundedNetwork, BoundedNetworkModel, on_the_bound

STATES, OUTPUTS, STATIC_OUTPUTS = 4, 4, 2
STEPS = 39
INITIAL_STATE = np.array([0.15, 0.16, 0.1, -0.2])
NOISE_BOUND = np.sqrt(10.0)


def transition(step: int) -> np.ndarray:
    """A (4, 4)."""
    return np.array(
        [
            [1.19 + 0.2 * np.sin(10 * step), 0.25, 0.0, 0.0],
            [-0.1, 0.16 - 0.2 * np.cos(2 * step), 0.0, 0.0],
            [0.2, 0.0, -0.8, -0.1 * np.sin(4 * step)],
            [0.0, 0.0, 0.1, 1.0],
        ]
    )


def noise_input(step: int) -> np.ndarray:
    """B (4, 1)."""
    first, second = 0.13 + 0.2 * np.sin(10 * step), 0.15 - 0.2 * np.cos(2 * step)
    return np.array([[first], [second], [0.2], [-0.15]])


def output(step: int) -> np.ndarray:
    """C (4, 4)."""
    return np.diag([9 + 0.3 * np.cos(-2 * step), 1.8 - 0.1 * np.cos(3 * step), 6.0, 8.0])


def feedthrough(step: int) -> np.ndarray:
    """D (4, 1)."""
    return np.array([[0.12], [0.17 + 0.27 * np.cos(step)], [0.2], [-0.2]])


def weights(step: int) -> np.ndarray:
    """Q_3 and Q_4 (2,), of the outputs that contend."""
    return np.array([2.0, 1.0])


def printed_noise(steps: int) -> np.ndarray:
    """w = 0.3 sin(-T) (steps, 1) in units of its bound."""
    return 0.3 * np.sin(-np.arange(steps, dtype=float))[:, None] / NOISE_BOUND


SYSTEM = BoundedSystem(
    transition=transition,
    noise_input=noise_input,
    output=output,
    feedthrough=feedthrough,
    noise_shape=lambda _: np.array([[10.0]]),
)

# Where a known control enters in the network, which the paper does not have: the unstable state.
CONTROL_MATRIX = np.eye(STATES)[:, :1]
_FEEDBACK = np.array([[0.7, 0.0, 0.0, 0.0]])


class Stabiliser:
    """u = -0.7 x1: keeps the first state bounded, on its own between 0.29 and 0.69 per step."""

    initial_memory = np.zeros(0)

    def control(
        self, state_estimate: np.ndarray, memory: np.ndarray, step: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the control (1,) for an estimate (4,); nothing is remembered."""
        return -(state_estimate @ _FEEDBACK.T), memory


def network(nodes: int, noise: str) -> BoundedNetwork:
    """Return the example with its outputs dealt out to nodes.

    Args:
        nodes: how many.
        noise: "paper" for state and noise as printed; "matched" for an initial state and noise on
            their bounds, as large as the filters must expect.
    """
    printed = noise == "paper"
    return BoundedNetwork(
        system=SYSTEM,
        model=BoundedNetworkModel(SYSTEM, CONTROL_MATRIX),
        nodes=nodes,
        noise_bounds=NOISE_BOUND * np.array([0.12, 0.44, 0.2, 0.2]),
        prior_shape=np.eye(STATES),
        noise=(lambda _, steps: printed_noise(steps)) if printed else partial(on_the_bound, size=1),
        start=(lambda _: INITIAL_STATE) if printed else _inside,
        state_names=("x1", "x2", "x3", "x4"),
        state_units=("1",) * STATES,
    )


def _inside(direction: np.ndarray) -> np.ndarray:
    """Return the direction, as long as the unit ball allows."""
    return direction / np.linalg.norm(direction)
