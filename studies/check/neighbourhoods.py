"""Neighbourhoods of beliefs, drawn from a number, and cut to fewer neighbours and states."""

from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian

LANES = (2, 3)
MOST_NEIGHBOURS, MOST_STATES = 5, 4
# Natural logarithms of the variances along the axes of a covariance.
_SIZES = (-3.0, 3.0)
_UNHEARD = 0.25


class Neighbourhood(NamedTuple):
    """Beliefs (R, N, 1 + J, n) with weights (R, N, 1 + J), the own first, drawn from a number."""

    number: int
    beliefs: Gaussian
    weights: np.ndarray

    @property
    def neighbours(self) -> int:
        """Number of neighbours J."""
        return self.weights.shape[-1] - 1

    @property
    def states(self) -> int:
        """Number of states n."""
        return self.beliefs.mean.shape[-1]

    @property
    def generator(self) -> np.random.Generator:
        """The stream of numbers that a promise draws beside the beliefs."""
        return _generator(self.number, 1)

    def cut(self, neighbours: int, states: int) -> "Neighbourhood":
        """The same with fewer neighbours and states."""
        mean, cov = self.beliefs
        kept = slice(neighbours + 1)
        beliefs = Gaussian(mean[..., kept, :states], cov[..., kept, :states, :states])
        return Neighbourhood(self.number, beliefs, normalised(self.weights[..., kept]))

    def values(self) -> dict[str, list[float]]:
        """The first lane in numbers."""
        return {
            "mean": self.beliefs.mean[0, 0].tolist(),
            "cov": self.beliefs.cov[0, 0].tolist(),
            "weights": self.weights[0, 0].tolist(),
        }


def draw_neighbourhood(number: int) -> Neighbourhood:
    """Return the neighbourhood of a number; a neighbour may have weight 0, the own belief not."""
    generator = _generator(number, 0)
    neighbours = int(generator.integers(1, MOST_NEIGHBOURS + 1))
    states = int(generator.integers(1, MOST_STATES + 1))
    shape = (*LANES, 1 + MOST_NEIGHBOURS)
    axes = np.linalg.qr(generator.standard_normal((*shape, MOST_STATES, MOST_STATES)))[0]
    variances = np.exp(generator.uniform(*_SIZES, (*shape, MOST_STATES)))
    covs = (axes * variances[..., None, :]) @ axes.mT
    means = generator.normal(0, 3, (*shape, MOST_STATES))
    weights = generator.uniform(0.1, 1, shape)
    weights[..., 1:] *= generator.random(weights[..., 1:].shape) > _UNHEARD
    beliefs = Gaussian(means, 0.5 * (covs + covs.mT))
    return Neighbourhood(number, beliefs, weights).cut(neighbours, states)


def normalised(weights: np.ndarray) -> np.ndarray:
    """Weights (..., J) scaled to sum 1."""
    return weights / weights.sum(axis=-1, keepdims=True)


def at_lane(belief: Gaussian, lane: tuple[int, ...]) -> Gaussian:
    """The belief of one lane."""
    return Gaussian(belief.mean[lane], belief.cov[lane])


def apart(one: Gaussian, other: Gaussian) -> float:
    """Largest difference of two beliefs (..., n), in standard deviations of the other; infinite
    where one of them alone is NaN."""
    deviation = np.sqrt(np.diagonal(other.cov, axis1=-2, axis2=-1))
    means = np.abs(one.mean - other.mean) / deviation
    covs = np.abs(one.cov - other.cov) / (deviation[..., None] * deviation[..., None, :])
    failed = np.isnan(other.mean).any(axis=-1) & np.isnan(one.mean).any(axis=-1)
    largest = np.maximum(means.max(axis=-1), covs.max(axis=(-1, -2)))
    return float(np.where(failed, 0.0, np.where(np.isnan(largest), np.inf, largest)).max())


def _generator(number: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(number, spawn_key=(purpose,)))
