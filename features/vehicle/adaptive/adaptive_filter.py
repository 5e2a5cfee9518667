"""A filter that learns the noise of its sensor: any filter, and a law by which the noise is learnt.

The memory holds a factor for the variance of each channel of the sensor. A factor has no unit, so
the same settings suit every sensor, and a sensor whose noise changes from reading to reading keeps
that form. Noises R of the data sheet become D R D with D the square roots of the factors.
"""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from concord.features.vehicle.adaptive.noise_law import NoiseLaw, ReadingEvidence
from concord.features.vehicle.adaptive.sage_husa import unexplained
from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.update import Update

Memory = TypeVar("Memory")


@dataclass(frozen=True, eq=False)
class AdaptiveFilter(Generic[Memory]):
    """`inner` with noise by a `law`: a `concord.filters.filter.LearningFilter`.

    A reading beyond the gate teaches all the same, or the noise could never grow to let it in.
    `rule` gives the points at which a posterior predicts its reading.
    """

    inner: Filter
    law: NoiseLaw[Memory]
    rule: SigmaPointRule

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the result of the inner filter."""
        return self.inner.predict(belief, transition, noise_cov)

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
        """Return the result of the inner filter, with the noise of the data sheet."""
        return self.inner.update(
            belief, measurement, measure, noise_cov, residual=residual, gate=gate
        )

    def begin(self, shape: tuple[int, ...], /) -> Memory:
        """The memory before the first reading (..., m) of this shape."""
        return self.law.begin(shape)

    def update_and_learn(
        self,
        belief: Gaussian,
        memory: Memory,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> tuple[Update, Memory]:
        """The belief with the noise learnt so far, and the memory after this reading."""
        root = np.sqrt(self.law.factors(memory))
        learnt = root[..., :, None] * noise_cov * root[..., None, :]
        found = self.inner.update(
            belief, measurement, measure, learnt, residual=residual, gate=gate
        )
        declared = np.diagonal(noise_cov, axis1=-2, axis2=-1)
        # A channel without noise has no unit to learn in, and learns nothing.
        declared = np.where(declared > 0, declared, np.nan)
        deviation = np.sqrt(declared)

        def rest() -> tuple[np.ndarray, np.ndarray]:
            left, spread = unexplained(found.belief, measurement, measure, self.rule, residual)
            return left / deviation, spread / declared

        expected = np.diagonal(found.innovation_cov, axis1=-2, axis2=-1) / declared
        evidence = ReadingEvidence(found.innovation / deviation, expected, rest)
        return found, self.law.adapt(memory, evidence)
