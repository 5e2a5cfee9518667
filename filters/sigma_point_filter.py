"""Filters that a sigma-point rule makes: unscented and cubature Kalman filters."""

from dataclasses import dataclass

import numpy as np

from concord.filters import ukf
from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import solve_spd, symmetrise
from concord.filters.moments import Model, Residual
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.update import Update


@dataclass(frozen=True, eq=False)
class SigmaPointFilter:
    """`ukf.predict` and `ukf.update` with one rule, as a value."""

    rule: SigmaPointRule

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """Return the result of `ukf.predict`."""
        return ukf.predict(belief, transition, noise_cov, self.rule)

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
        """Return the result of `ukf.update`."""
        return ukf.update(
            belief, measurement, measure, noise_cov, self.rule, residual=residual, gate=gate
        )

    def linearise(
        self, belief: Gaussian, measure: Model, size: int, residual: Residual, /
    ) -> Affine:
        """Statistical linear regression: A = C' P^-1 with an error of covariance S - A C.

        C is the covariance of state and measurement, and S that of the measurement. Source:
        Arasaratnam, Haykin and Elliott (2007), Discrete-time nonlinear filtering algorithms using
        Gauss-Hermite quadrature, section III.
        """
        predicted, cov, cross_cov = ukf.measured(belief, measure, size, self.rule, residual)
        slope = solve_spd(belief.cov, cross_cov).mT
        return Affine(predicted, slope, symmetrise(cov - slope @ cross_cov))
