"""The unscented Kalman filter with additive noise, one function per half step.

Models are plain callables on sigma points, (S, ..., n) -> (S, ..., n or m); the caller binds
control and time. Any strides may come back, and nothing is written into what a model returned.

Source: Wan and Van der Merwe (2001), The unscented Kalman filter, in Haykin (ed.), Kalman filtering
and neural networks, chapter 7, the form for additive noise; with the points redrawn from the
predicted belief before the update, so that they spread with the process noise as well.
"""

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, multiply, symmetrise
from filters.moments import Model, Residual, check_noise, evaluate, moments, points_last
from filters.sigma_points import SigmaPointRule, sigma_points
from filters.update import Update, missing_entries, settle, without_rows


def predict(
    belief: Gaussian,
    transition: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
) -> Gaussian:
    """The belief one step later.

    Args:
        belief: mean (..., n), cov (..., n, n).
        transition: points (S, ..., n) -> points (S, ..., n).
        noise_cov: covariance of the additive process noise, (n, n) or (..., n, n).
        rule: a sigma-point rule for n dimensions.
        residual: difference of two states, for states with angles.

    Returns:
        The predicted belief; NaN in a lane whose covariance is not positive definite.

    Raises:
        ValueError: the rule, the noise or the model's values do not fit the state.
    """
    n = belief.mean.shape[-1]
    check_noise(noise_cov, n, "process noise covariance")
    points = sigma_points(belief, rule)
    mean, deviations = moments(evaluate(transition, points, n, "transition"), rule, residual)
    weighted = rule.cov_weights[:, None] * deviations
    return Gaussian(mean, symmetrise(weighted.mT @ deviations + noise_cov))


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measure: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    *,
    residual: Residual = np.subtract,
    state_residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update[Gaussian]:
    """The belief given a measurement.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken, as if the sensor had no such row.
        measure: points (S, ..., n) -> predicted measurements (S, ..., m).
        noise_cov: covariance of the additive measurement noise, (m, m) or (..., m, m).
        rule: a sigma-point rule for n dimensions.
        residual: difference of two measurements, for measurements with angles.
        state_residual: difference of two states; it matters only where the points spread over more
            than half a turn of an angle.
        gate: lanes whose normalised innovation squared exceeds it keep their belief; choose a
            quantile of the chi-square distribution with m degrees of freedom.

    Returns:
        An Update; NaN in a lane whose state or innovation covariance is not positive definite. A
        lane with nothing taken, or gated out, keeps its belief bit for bit.

    Raises:
        ValueError: the rule, the noise, the measurement or the model's values do not fit.
    """
    measurement = np.asarray(measurement, dtype=float)
    m = measurement.shape[-1]
    check_noise(noise_cov, m, "measurement noise covariance")
    points = sigma_points(belief, rule)
    predicted, deviations = moments(evaluate(measure, points, m, "measure"), rule, residual)
    weighted = rule.cov_weights[:, None] * deviations
    innovation_cov = weighted.mT @ deviations + noise_cov
    cross_cov = points_last(state_residual(points, belief.mean)).mT @ weighted

    missing = missing_entries(measurement)
    if missing is None:
        innovation = residual(measurement, predicted)
    else:
        taken = np.where(missing, predicted, measurement)
        innovation = np.where(missing, 0.0, residual(taken, predicted))
        innovation_cov = without_rows(innovation_cov, missing)
        cross_cov = np.where(missing[..., None, :], 0.0, cross_cov)

    # With S = C C', the whitened gain G = K C = P_xz C^-T makes the posterior P - G G', which is
    # symmetric as it is computed, and needs no inverse but that of a triangle.
    whitener = np.linalg.inv(cholesky(innovation_cov))
    whitened = multiply(whitener, innovation)
    gain = cross_cov @ whitener.mT
    after = Gaussian(belief.mean + multiply(gain, whitened), belief.cov - gain @ gain.mT)
    squared = np.vecdot(whitened, whitened)
    return settle(belief, after, innovation, innovation_cov, squared, missing, gate)
