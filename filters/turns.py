"""States that are angles: a belief stands on any turn of the circle, and fusion needs one turn.

The mean of an angle goes on counting beyond pi, so that every difference of beliefs of one node is
plain. Beliefs of other nodes may be whole turns away. A neighbourhood is put on one turn before it
is averaged, and an estimate on the turn next to the truth before its error is taken.
"""

import math
from typing import Any

import numpy as np

from concord.filters.gaussian import Information
from concord.filters.linalg import multiply

Angles = tuple[int, ...]
"""States that are angles in rad."""


def angles_of(model: Any) -> Angles:
    """The states of a model that are angles; none of a model that says nothing of them."""
    return tuple(getattr(model, "angles", ()))


def turns_between(mean: np.ndarray, other: np.ndarray, angles: Angles) -> np.ndarray:
    """The whole turns (..., n) in rad from means (..., n) to the turn next to others (..., n).

    They are 0 where one is not finite.
    """
    turns = np.zeros(np.broadcast_shapes(mean.shape, other.shape))
    places = list(angles)
    away = (other - mean)[..., places]
    turns[..., places] = math.tau * np.round(np.where(np.isfinite(away), away, 0.0) / math.tau)
    return turns


def beside(mean: np.ndarray, other: np.ndarray | float, angles: Angles) -> np.ndarray:
    """Means (..., n) on the turns next to others (..., n); the same where no state is an angle."""
    if not angles:
        return mean
    return mean + turns_between(mean, np.asarray(other) + np.zeros(mean.shape[-1]), angles)


def turns_to_own(
    means: np.ndarray, variances: np.ndarray, weights: np.ndarray, angles: Angles
) -> np.ndarray:
    """The whole turns (..., J, n) in rad that put the means of a neighbourhood on one turn.

    That turn is the one next to the direction of them all, which is next to the own mean, entry 0.
    To put each next to the own mean alone would part neighbours that agree, where a node that knows
    little happens to look the other way.

    Args:
        means, variances: (..., J, n). Entries that are not finite have no part in the
            direction.
        weights: (..., J), not negative.
    """
    places = list(angles)
    angle, variance = means[..., places], variances[..., places]
    heard = np.isfinite(angle) & (variance > 0) & np.isfinite(variance)
    sure = weights[..., None] * np.where(heard, 1 / np.where(heard, variance, 1.0), 0.0)
    angle = np.where(heard, angle, 0.0)
    sine, cosine = ((sure * part(angle)).sum(axis=-2, keepdims=True) for part in (np.sin, np.cos))
    direction = np.arctan2(sine, cosine)
    direction = direction + math.tau * np.round((angle[..., :1, :] - direction) / math.tau)
    turns = np.zeros_like(means)
    turns[..., places] = math.tau * np.round((direction - angle) / math.tau)
    turns[..., 0, :] = 0.0
    return turns


def turned(information: Information, turns: np.ndarray) -> Information:
    """Information (..., n) of a state from which whole turns (..., n) in rad are away."""
    matrix = information.matrix
    return Information(information.vector + multiply(matrix, turns), matrix)
