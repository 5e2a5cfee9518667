"""The extended Kalman filter: models are replaced by their tangents at the mean.

Jacobians are central differences over `step` standard deviations of the belief, so that units do
not matter. The relative error of an entry has two parts. Curvature contributes step^2 / 6 times
the third derivative at the scale of one standard deviation. Rounding contributes 1e-16 / step times
the ratio of the value to its change over one standard deviation. For affine models the first part
is zero, and a step of 1 gives the Kalman filter to rounding. So a second difference is taken over
one standard deviation, and stands wherever it equals the first one to that one's rounding. A
complex step would be exact for analytic models, but arctan2, abs and hypot of sensors do not take
complex numbers.

Source: Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, section 10.3. No covariance is factored but that of the innovation, so the covariance of
a belief may be singular.
"""

from dataclasses import dataclass

import numpy as np

from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply, symmetrise
from concord.filters.moments import Model, Residual, check_noise, evaluate
from concord.filters.update import Update, condition

_WIDE_STEP = 1.0
# Roundings of a value and of its summands by which a difference may be wrong.
_ROUNDINGS = 8 * 2.0**-52


@dataclass(frozen=True)
class ExtendedFilter:
    """The extended Kalman filter; `step` of the differences in standard deviations."""

    step: float = 1e-3

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """The belief one step later: f(x), F P F' + Q.

        Raises:
            ValueError: the noise or the model's values do not fit the state.
        """
        n = belief.mean.shape[-1]
        check_noise(noise_cov, n, "process noise covariance")
        mean, F = self._tangent(belief, transition, n, "transition", np.subtract)
        return Gaussian(mean, symmetrise(F @ belief.cov @ F.mT) + noise_cov)

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
        """The belief given a measurement, as `ukf.update`.

        Raises:
            ValueError: the noise, the measurement or the model's values do not fit.
        """
        measurement = np.asarray(measurement, dtype=float)
        m = measurement.shape[-1]
        check_noise(noise_cov, m, "measurement noise covariance")
        predicted, H = self._tangent(belief, measure, m, "measure", residual)
        cross_cov = belief.cov @ H.mT
        innovation_cov = symmetrise(H @ cross_cov) + noise_cov
        return condition(belief, measurement, predicted, innovation_cov, cross_cov, residual, gate)

    def linearise(
        self, belief: Gaussian, measure: Model, size: int, residual: Residual, /
    ) -> Affine:
        """The tangent at the mean, as if it had no error."""
        predicted, slope = self._tangent(belief, measure, size, "measure", residual)
        return Affine(predicted, slope, np.zeros((*predicted.shape, size)))

    def _tangent(
        self, belief: Gaussian, model: Model, size: int, name: str, residual: Residual
    ) -> tuple[np.ndarray, np.ndarray]:
        """Value (..., size) at the mean, and Jacobian (..., size, n)."""
        n = belief.mean.shape[-1]
        variance = np.diagonal(belief.cov, axis1=-2, axis2=-1)
        # Without an uncertainty the slope has no effect, and any step will do.
        deviation = np.where(variance == 0, 1.0, np.sqrt(np.abs(variance)))
        wide = np.where(variance == 0, self.step, _WIDE_STEP)
        steps = [self.step] if self.step >= _WIDE_STEP else [self.step, wide]
        axes = np.eye(n).reshape(n, *(1,) * (deviation.ndim - 1), n) * deviation
        offset = np.concatenate([step * axes for step in steps])
        ahead, behind = belief.mean + offset, belief.mean - offset
        points = np.concatenate([belief.mean + 0 * offset[:1], ahead, behind])
        values = evaluate(model, points, size, name)
        # The distance of the points as they were rounded; NaN where they are one number.
        apart = (ahead - behind).reshape(len(steps), n, *offset.shape[1:])
        apart = np.diagonal(apart, axis1=1, axis2=-1)
        apart = np.where(apart == 0, np.nan, apart)
        rise = residual(values[1 : len(offset) + 1], values[len(offset) + 1 :])
        rise = np.moveaxis(rise.reshape(len(steps), n, *values.shape[1:]), 1, -1)
        slopes = rise / apart[..., None, :]
        if len(steps) == 1:
            return values[0], slopes[0]
        narrow, secant = slopes
        summands = np.abs(values[0]) + multiply(np.abs(secant), np.abs(belief.mean))
        rounding = _ROUNDINGS * summands[..., None] / np.abs(apart[0])[..., None, :]
        return values[0], np.where(np.abs(secant - narrow) <= rounding, secant, narrow)
