"""The unscented Kalman filter with additive noise, one function per half step.

With sigma points X_s of weights w_s, and the model's values Y_s = f(X_s) at them:

    predict   x = sum w_s Y_s,  P = sum w_s (Y_s - x) (Y_s - x)' + Q

    update    y = sum w_s Y_s,  S = sum w_s (Y_s - y) (Y_s - y)' + R,
              C = sum w_s (X_s - x) (Y_s - y)',  K = C S^-1,
              x + K (z - y),  P - K S K'

Sigma points lie on the first axis; all axes between it and the last are lanes, and free. Models are
plain callables on sigma points, (S, ..., n) -> (S, ..., n or m); the caller binds control and time.

Source: Wan and Van der Merwe (2001), The unscented Kalman filter, in Haykin (ed.), Kalman filtering
and neural networks, chapter 7, the form for additive noise. The points are redrawn from the
predicted belief before the update, so that they spread with the process noise as well.
"""

from typing import NamedTuple

import numpy as np

from concord.filters import square_root
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, symmetrise
from concord.filters.moments import (
    Model,
    Residual,
    check_noise,
    evaluate,
    sum_of_products,
    weigh,
    weighted_mean,
)
from concord.filters.sigma_points import SigmaPointRule, sigma_points
from concord.filters.update import Update, chosen, condition


class Propagated(NamedTuple):
    """Sigma points (S, ..., n) of a belief, the weighted deviations (S, ..., n) of their values
    from the predicted mean, and the predicted belief."""

    points: np.ndarray
    weighted: np.ndarray
    predicted: Gaussian


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
    return propagated(belief, transition, noise_cov, rule, residual).predicted


def propagated(
    belief: Gaussian,
    transition: Model,
    noise_cov: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
) -> Propagated:
    """The sigma points of a belief through the model; arguments as in `predict`."""
    n = belief.mean.shape[-1]
    check_noise(noise_cov, n, "process noise covariance")
    points = sigma_points(belief, rule)
    values = evaluate(transition, points, n, "transition")
    mean = weighted_mean(values, rule, residual)
    away = residual(values, mean)
    weighted = weigh(away, rule)
    cov = symmetrise(sum_of_products(weighted, away)) + noise_cov
    return Propagated(points, weighted, Gaussian(mean, cov))


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
) -> Update:
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
        lane with nothing taken, or gated out, keeps its belief bit for bit. A lane whose reading is
        far sharper than its prediction is computed in square-root form (`square_root`); it is NaN
        where the covariance cannot hold the result.

    Raises:
        ValueError: the rule, the noise, the measurement or the model's values do not fit.
    """
    measurement = np.asarray(measurement, dtype=float)
    m = measurement.shape[-1]
    check_noise(noise_cov, m, "measurement noise covariance")
    predicted, cov, cross_cov = measured(belief, measure, m, rule, residual, state_residual)
    found = condition(belief, measurement, predicted, cov + noise_cov, cross_cov, residual, gate)
    sharp = square_root.cancels(cov, noise_cov, measurement)
    if sharp is None or state_residual is not np.subtract:
        return found
    if (rule.cov_weights >= 0).all():
        exact = square_root.update(belief, measurement, measure, noise_cov, rule, residual, gate)
        found = chosen(sharp, exact, found)
    is_lost = sharp & np.isnan(cholesky(found.belief.cov)).any(axis=(-1, -2))
    lost = Gaussian(*(np.full_like(part, np.nan) for part in found.belief))
    return chosen(is_lost, found._replace(belief=lost), found)


def measured(
    belief: Gaussian,
    measure: Model,
    size: int,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
    state_residual: Residual = np.subtract,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Moments of a measurement without noise: mean (..., m), covariance (..., m, m), and covariance
    of state and measurement (..., n, m), for m = `size`; other arguments as in `update`."""
    points = sigma_points(belief, rule)
    values = evaluate(measure, points, size, "measure")
    predicted = weighted_mean(values, rule, residual)
    away = residual(values, predicted)
    weighted = weigh(away, rule)
    cross_cov = sum_of_products(state_residual(points, belief.mean), weighted)
    return predicted, symmetrise(sum_of_products(weighted, away)), cross_cov
