"""Interacting multiple models: a filter for targets that change between motions.

A belief has a Gaussian for each of M models, and log odds of the models. All of it travels as one
Gaussian, the stacked belief, so that fusion, codecs and drivers take it as any other:

    mean (..., M n + M - 1): the means of the models, then log p_j / p_0 for j = 1 .. M - 1
    cov: the covariances of the models as blocks on the diagonal, then ones

Covariance intersection of stacked beliefs intersects model by model, and gives the model
probabilities their weighted geometric mean. The overlap of the Gaussians says nothing there.

Source: Blom and Bar-Shalom (1988), The interacting multiple model algorithm for systems with
Markovian switching coefficients, IEEE Trans. Automatic Control 33(8).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian, stacked_size
from concord.filters.linalg import cholesky, inverse_of_triangle, multiply
from concord.filters.moments import Model, Residual
from concord.filters.update import Update, settle, without_rows


class Mode(NamedTuple):
    """A model of motion, as a change of the plant's.

    `held` are states that the transition sees as 0. After it they are 0 again, with the standard
    deviation `std`: as if each step drew them anew.
    """

    held: tuple[int, ...] = ()
    std: float = 0.0

    def moved(self, transition: Model) -> Model:
        """The transition of points (S, ..., n)."""
        if not self.held:
            return transition
        places = list(self.held)

        def held_still(points: np.ndarray) -> np.ndarray:
            still = points.copy(order="K")
            still[..., places] = 0.0
            after = transition(still)
            after[..., places] = 0.0
            return after

        return held_still

    def noise_cov(self, noise_cov: np.ndarray) -> np.ndarray:
        """The process noise covariance (..., n, n)."""
        if not self.held:
            return noise_cov
        places, changed = list(self.held), noise_cov.copy()
        changed[..., places, :], changed[..., :, places] = 0.0, 0.0
        changed[..., places, places] = self.std**2
        return changed


class Mixture(NamedTuple):
    """A stacked belief taken apart: means (..., M, n), covs (..., M, n, n), and the logarithms of
    the model probabilities (..., M)."""

    means: np.ndarray
    covs: np.ndarray
    log_probabilities: np.ndarray


@dataclass(frozen=True, eq=False)
class InteractingModels:
    """A filter of M models between which the target changes from step to step.

    Attributes:
        inner: predicts and updates the belief of each model.
        states: n, the states of the plant.
        modes: the models, M of them.
        change: probability of a change of model in a step, to each other model alike.
    """

    inner: Filter
    states: int
    modes: tuple[Mode, ...]
    change: float

    @property
    def _switching(self) -> np.ndarray:
        """Probability (M, M) of model j after model i."""
        models = len(self.modes)
        if models == 1:
            return np.ones((1, 1))
        others = np.full((models, models), self.change / (models - 1))
        return np.where(np.eye(models, dtype=bool), 1 - self.change, others)

    def begun(self, belief: Gaussian) -> Gaussian:
        """The stacked belief of a belief (..., n): the same in all models, which are alike."""
        models, n = len(self.modes), self.states
        lanes = belief.mean.shape[:-1]
        return self.stacked(
            np.broadcast_to(belief.mean[..., None, :], (*lanes, models, n)),
            np.broadcast_to(belief.cov[..., None, :, :], (*lanes, models, n, n)),
            np.zeros((*lanes, models)),
        )

    def moments(self, belief: Gaussian) -> Gaussian:
        """Mean (..., n) and covariance (..., n, n) of a stacked belief."""
        means, covs, log_probabilities = self.apart(belief)
        return _merged(np.exp(log_probabilities), means, covs)

    def probabilities(self, belief: Gaussian) -> np.ndarray:
        """Model probabilities (..., M) of a stacked belief; they sum to 1."""
        return np.exp(self.apart(belief).log_probabilities)

    def apart(self, belief: Gaussian) -> Mixture:
        """The parts of a stacked belief."""
        models, n = len(self.modes), self.states
        lanes = belief.mean.shape[:-1]
        if models == 1:
            mean, cov = belief
            return Mixture(mean[..., None, :], cov[..., None, :, :], np.zeros((*lanes, 1)))
        blocks = [slice(model * n, (model + 1) * n) for model in range(models)]
        odds = np.concatenate((np.zeros((*lanes, 1)), belief.mean[..., models * n :]), axis=-1)
        return Mixture(
            belief.mean[..., : models * n].reshape(*lanes, models, n),
            np.stack([belief.cov[..., block, block] for block in blocks], axis=-3),
            _normalised(odds),
        )

    def stacked(self, means: np.ndarray, covs: np.ndarray, logs: np.ndarray) -> Gaussian:
        """The stacked belief of means (..., M, n), covs (..., M, n, n), and logarithms (..., M) of
        what the model probabilities are in proportion to."""
        models, n = len(self.modes), self.states
        if models == 1:
            return Gaussian(means[..., 0, :], covs[..., 0, :, :])
        size, lanes = stacked_size(n, models), means.shape[:-2]
        odds = logs[..., 1:] - logs[..., :1]
        mean = np.concatenate((means.reshape(*lanes, models * n), odds), axis=-1)
        cov = np.zeros((*lanes, size, size))
        for model in range(models):
            block = slice(model * n, (model + 1) * n)
            cov[..., block, block] = covs[..., model, :, :]
        last = np.arange(models * n, size)
        cov[..., last, last] = 1.0
        return Gaussian(mean, cov)

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """The stacked belief one step later: the models interact, then each predicts."""
        if len(self.modes) == 1:
            (mode,) = self.modes
            return self.inner.predict(belief, mode.moved(transition), mode.noise_cov(noise_cov))
        means, covs, logs = self.apart(belief)
        # Probability (..., i, j) of model i before the step and j in it.
        both = np.exp(logs)[..., :, None] * self._switching
        after = both.sum(axis=-2)
        moved = []
        for model, mode in enumerate(self.modes):
            mixed = _merged(both[..., model] / after[..., model, None], means, covs)
            moved.append(
                self.inner.predict(mixed, mode.moved(transition), mode.noise_cov(noise_cov))
            )
        return self.stacked(*_joined(moved), np.log(after))

    def update(
        self,
        belief: Gaussian,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> Update:
        """The stacked belief given a measurement; innovation and gate are those of the mixture."""
        measurement = np.asarray(measurement, dtype=float)
        means, covs, logs = self.apart(belief)
        found = [
            self.inner.update(
                Gaussian(means[..., model, :], covs[..., model, :, :]),
                measurement,
                measure,
                noise_cov,
                residual=residual,
            )
            for model in range(len(self.modes))
        ]
        squared = np.stack([one.normalised_innovation_squared for one in found], axis=-1)
        missing = np.isnan(measurement)
        innovation = np.stack([one.innovation for one in found], axis=-2)
        innovation = np.where(missing[..., None, :], 0.0, innovation)
        cov = np.stack([one.innovation_cov for one in found], axis=-3)
        cov = without_rows(cov, np.broadcast_to(missing[..., None, :], innovation.shape))
        # The rows that are missing are alike in all models.
        likelihood = -0.5 * squared - _log_volume(cov)
        after = self.stacked(*_joined([one.belief for one in found]), logs + likelihood)
        whole = _merged(np.exp(logs), innovation, cov)
        whitened = multiply(inverse_of_triangle(cholesky(whole.cov)), whole.mean)
        distance = np.vecdot(whitened, whitened)
        rows = missing if missing.any() else None
        return settle(belief, after, *whole, distance, rows, gate)


def _normalised(odds: np.ndarray) -> np.ndarray:
    """Logarithms (..., M) of the probabilities that have these log odds."""
    away = odds - odds.max(axis=-1, keepdims=True)
    return away - np.log(np.exp(away).sum(axis=-1, keepdims=True))


def _merged(weights: np.ndarray, means: np.ndarray, covs: np.ndarray) -> Gaussian:
    """Mean and covariance of a mixture of weights (..., M), whose sum is 1."""
    if means.shape[-2] == 1:
        return Gaussian(means[..., 0, :], covs[..., 0, :, :])
    mean = np.einsum("...m,...mi->...i", weights, means)
    away = means - mean[..., None, :]
    spread = covs + away[..., :, None] * away[..., None, :]
    return Gaussian(mean, np.einsum("...m,...mij->...ij", weights, spread))


def _joined(beliefs: list[Gaussian]) -> tuple[np.ndarray, np.ndarray]:
    means = np.stack([one.mean for one in beliefs], axis=-2)
    return means, np.stack([one.cov for one in beliefs], axis=-3)


def _log_volume(cov: np.ndarray) -> np.ndarray:
    """Half the log determinant (...) of covariances (..., m, m)."""
    return np.log(np.diagonal(cholesky(cov), axis1=-2, axis2=-1)).sum(axis=-1)
