"""A sensor that measures distance and direction to a target from a known place."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from concord.plants.motion import require_positive


def wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same angles (...) in rad, within (-pi, pi]."""
    # The minimum takes back one unit in the last place that rounding may add to pi.
    return np.minimum(angle - math.tau * np.ceil(angle / math.tau - 0.5), math.pi)


Moves = tuple[tuple[int, np.ndarray], ...]
"""Where sensors stand from a step on, in the order of the steps."""


@dataclass(frozen=True, eq=False)
class RangeBearing:
    """Range in m and bearing in rad, anticlockwise from the x axis, of a state [x, vx, y, vy, ...].

    `position_m` is (2,) for one node, or (nodes, 2) for all: then the states' last leading axis is
    the nodes' (or 1). `moves` are places of the same shape, each from a step on, in their order.

    Raises:
        ValueError: for positions of another shape or deviations that are not positive.
    """

    position_m: np.ndarray
    range_std_m: float = 10.0
    bearing_std_rad: float = math.radians(2)
    gate: float | None = None  # greatest normalised innovation squared that a filter accepts
    moves: Moves = ()

    channels = (("range", "m"), ("bearing", "rad"))

    def __post_init__(self) -> None:
        shape = np.shape(self.position_m)
        if not shape or shape[-1] != 2 or not np.isfinite(self.position_m).all():
            raise ValueError(
                f"position_m has shape {shape}, but must be finite with shape (2,) or (nodes, 2)"
            )
        require_positive(range_std_m=self.range_std_m, bearing_std_rad=self.bearing_std_rad)

    def for_node(self, node: int | np.ndarray) -> "RangeBearing":
        """Return the sensor of one of the nodes, or of nodes (...) for states (..., n)."""
        moves = tuple((step, places[node]) for step, places in self.moves)
        return replace(self, position_m=self.position_m[node], moves=moves)

    def places(self, step: int) -> np.ndarray:
        """Positions in m at a step, (2,) or (nodes, 2)."""
        moved = (places for first, places in reversed(self.moves) if first <= step)
        return next(moved, self.position_m)

    def measure(self, state: np.ndarray, step: int) -> np.ndarray:
        """Range and bearing (..., 2) of states (..., n), without noise."""
        place = self.places(step)
        dx = state[..., 0] - place[..., 0]
        dy = state[..., 2] - place[..., 1]
        value = np.empty_like(state, shape=(*dx.shape, 2))
        value[..., 0] = np.sqrt(dx * dx + dy * dy)
        value[..., 1] = np.arctan2(dy, dx)
        return value

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a - b (..., 2), its bearing within (-pi, pi]."""
        difference = a - b
        difference[..., 1] = wrapped(difference[..., 1])
        return difference

    def interpret(self, delivered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the delivered (..., 2) as it is, and its noise covariance (..., 2, 2)."""
        return delivered, np.broadcast_to(self._noise_cov, (*delivered.shape, 2))

    @property
    def noise_std(self) -> np.ndarray:
        """Standard deviations (2,) in m and rad."""
        return np.array([self.range_std_m, self.bearing_std_rad])

    @cached_property
    def _noise_cov(self) -> np.ndarray:
        return np.diag(self.noise_std**2)
