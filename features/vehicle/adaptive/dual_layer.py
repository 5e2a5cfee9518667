"""The dual-layer unscented Kalman filter in its consistent form: each sigma point has its own UKF.

The first layer updates a filter at each cubature point of the belief, and averages them. The second
layer updates their average. Each layer takes the reading with the noise 2 R, so that it counts
once. On linear models the result is that of the Kalman filter. Elsewhere the second layer draws its
points nearer to the reading.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter, section 3.2. The paper takes the reading with the noise R in both layers, which counts it
twice (`concord.papers.adlukf.dual_layer`).
"""

from dataclasses import dataclass

import numpy as np

from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import symmetrise
from concord.filters.moments import Model, Residual
from concord.filters.sigma_points import SigmaPointRule, cubature, sigma_points
from concord.filters.update import Update, missing_entries, settle


@dataclass(frozen=True, eq=False)
class DualLayerFilter:
    """The predictions of `ukf`, and an update in two layers, with one rule for the inner points."""

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
        """The belief given a measurement, as `ukf.update`; innovation and gate are those of it."""
        measurement = np.asarray(measurement, dtype=float)
        first = ukf.update(belief, measurement, measure, noise_cov, self.rule, residual=residual)
        # Points of equal positive weights: an average of covariances stays positive definite.
        points = sigma_points(belief, cubature(belief.mean.shape[-1]))
        each = Gaussian(points, np.broadcast_to(belief.cov, (*points.shape, points.shape[-1])))
        readings = np.broadcast_to(measurement, (len(points), *measurement.shape))
        half = 2.0 * noise_cov
        inner = ukf.update(each, readings, measure, half, self.rule, residual=residual).belief
        outer = Gaussian(inner.mean.mean(axis=0), symmetrise(inner.cov.mean(axis=0)))
        after = ukf.update(outer, measurement, measure, half, self.rule, residual=residual).belief
        return settle(
            belief,
            after,
            first.innovation,
            first.innovation_cov,
            first.normalised_innovation_squared,
            missing_entries(measurement),
            gate,
        )
