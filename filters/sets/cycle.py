"""One communication cycle as a set-membership filter sees it: what is unknown, and what is known.

The unknowns are u, where in its ellipsoid the state was, and the noise v of the cycle's g samples,
each within the unit ball. Noise maps have shape (rows, g, q).

Source: Liu et al. (2021), section V.
"""

from typing import NamedTuple

import numpy as np

from concord.filters.lanes import join_columns
from concord.filters.linalg import multiply
from concord.filters.sets.ellipsoid import (
    Ellipsoid,
    grow,
    half_widths,
    is_lost,
    lose,
    rounding_bound,
    squared,
)
from concord.filters.sets.lifted_cycle import AugmentedCycle


class CycleResult(NamedTuple):
    """Result of a filter for one cycle: the ellipsoid after it, and the feedback L (..., N, m)."""

    after: Ellipsoid
    gain: np.ndarray


class Unknowns(NamedTuple):
    """Next state and received values: linear maps (..., N, d), (..., m, d) of theta = (1, u, v)."""

    image: np.ndarray
    known: np.ndarray


def unknowns(position: np.ndarray, cycle: AugmentedCycle) -> Unknowns:
    """Errors of the state and of the received values as they come from theta; no constant part.

    position: (..., N, r), a factor of the ellipsoid before, `turned` or as it is.
    """
    noise, output_noise = flat(cycle.noise), flat(cycle.output_noise)
    image = join_columns(cycle.transition @ position, noise)
    known = join_columns(cycle.output @ position, output_noise)
    return Unknowns(_without_constant(image), _without_constant(known))


def turned(factor: np.ndarray, cycle: AugmentedCycle) -> np.ndarray:
    """The factor with u turned so that as few entries as possible are seen; the others left out.

    The cycle depends on only some coordinates of the state (the last block and the held values).
    With those rows made triangular, the other columns have no effect, and the worst u is 0 there.
    """
    parts = (cycle.transition, cycle.output, cycle.candidates)
    used = np.any([(part != 0).any(tuple(range(part.ndim - 1))) for part in parts], axis=0)
    seen = squared(factor[..., used, :])
    position = np.zeros((*factor.shape[:-1], seen.shape[-1]))
    position[..., used, :] = seen
    return position


def follow(
    before: Ellipsoid,
    cycle: AugmentedCycle,
    received: np.ndarray,
    factor: np.ndarray,
    gain: np.ndarray,
) -> CycleResult:
    """(17) and the shape that was found, grown by the rounding of the whole step."""
    innovation = received - multiply(cycle.output, before.centre)
    centre = multiply(cycle.transition, before.centre) + multiply(gain, innovation)
    after = grow(Ellipsoid(centre, factor), _rounding(before, cycle, received, gain))
    return CycleResult(lose(after, is_lost(after)), gain)


def flat(noise: np.ndarray) -> np.ndarray:
    """Noise map (..., rows, g, q) as a matrix (..., rows, g q)."""
    return noise.reshape(*noise.shape[:-2], noise.shape[-2] * noise.shape[-1])


def ball(first: int, count: int, size: int, radius: float) -> np.ndarray:
    """The term (size, size) of |theta[first : first + count]|^2 <= radius."""
    diagonal = np.zeros(size)
    diagonal[first : first + count] = 1.0
    diagonal[0] = -radius
    return np.diag(diagonal)


def _without_constant(matrix: np.ndarray) -> np.ndarray:
    """A map of (u, v) as one of (1, u, v)."""
    return join_columns(np.zeros((matrix.shape[-2], 1)), matrix)


def _rounding(
    before: Ellipsoid, cycle: AugmentedCycle, received: np.ndarray, gain: np.ndarray
) -> np.ndarray:
    """Half-widths (..., N) within which truth and filter, both rounded, part from their equations.

    Every entry is given the largest, for a cycle's last step multiplies the errors of the first.
    """
    reach = np.abs(before.centre) + half_widths(before)
    noise = np.sqrt((cycle.noise**2).sum(-1)).sum(-1)
    output_noise = np.sqrt((cycle.output_noise**2).sum(-1)).sum(-1)
    outputs = multiply(np.abs(cycle.output), reach) + output_noise + np.abs(received)
    states = multiply(np.abs(cycle.transition), reach) + noise + multiply(np.abs(gain), outputs)
    terms = cycle.transition.shape[-1] + cycle.noise[0, ...].size
    largest = rounding_bound(terms) * states.max(-1, keepdims=True)
    return np.broadcast_to(largest, states.shape)
