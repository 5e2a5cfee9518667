"""The extended Kalman filter: the Kalman filter at the models' linearisation about the mean.

Source: Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, chapter 10 (first order).
"""

import numpy as np

from filters.gaussian import Gaussian
from filters.kalman import linear_update
from filters.linalg import symmetrise
from filters.moments import Model, Residual, check_noise
from filters.update import Update, missing_entries


def predict(
    belief: Gaussian, transition: Model, jacobian: Model, noise_cov: np.ndarray
) -> Gaussian:
    """The belief one step later, to first order.

    Args:
        belief: mean (..., n), cov (..., n, n).
        transition: states (..., n) -> states (..., n).
        jacobian: states (..., n) -> derivative of the transition, (..., n, n).
        noise_cov: covariance of the additive process noise, (n, n) or (..., n, n).

    Raises:
        ValueError: the noise does not fit the state.
    """
    check_noise(noise_cov, belief.mean.shape[-1], "process noise covariance")
    F = jacobian(belief.mean)
    return Gaussian(transition(belief.mean), symmetrise(F @ belief.cov @ F.mT + noise_cov))


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measure: Model,
    jacobian: Model,
    noise_cov: np.ndarray,
    *,
    residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update[Gaussian]:
    """The belief given a measurement, to first order.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        measure: states (..., n) -> predicted measurements (..., m).
        jacobian: states (..., n) -> derivative of `measure`, (..., m, n).
        noise_cov: covariance of the additive measurement noise, (m, m) or (..., m, m).
        residual: difference of two measurements, for measurements with angles.
        gate: lanes whose normalised innovation squared exceeds it keep their belief.

    Returns:
        An Update, as `kalman.update`.

    Raises:
        ValueError: the noise does not fit the measurement.
    """
    measurement = np.asarray(measurement, dtype=float)
    innovation = residual(measurement, measure(belief.mean))
    missing = missing_entries(measurement)
    return linear_update(belief, innovation, jacobian(belief.mean), noise_cov, missing, gate)
