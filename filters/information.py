"""The Kalman filter in information form, which may begin by knowing nothing.

Source: Anderson and Moore (1979), Optimal filtering, section 6.3. The prediction is written with
the inverse of I + M Q, which exists for every positive semi-definite M and Q, so that neither the
information matrix nor the process noise has to be regular.
"""

import numpy as np

from filters.gaussian import Information
from filters.linalg import inverse_spd, multiply, symmetrise
from filters.moments import check_noise
from filters.update import missing_entries, without_rows


def predict(
    information: Information,
    transition_matrix: np.ndarray,
    noise_cov: np.ndarray,
    control_term: np.ndarray | float = 0.0,
) -> Information:
    """The information one step later: x = F x + G u + w.

    Args:
        information: vector (..., n), matrix (..., n, n), which may be singular, even zero.
        transition_matrix: F, (n, n) or (..., n, n), invertible.
        noise_cov: Q, covariance of w, (n, n) or (..., n, n), which may be singular.
        control_term: G u, (..., n).

    Raises:
        ValueError: F is singular, or the noise does not fit the state.
    """
    n = information.vector.shape[-1]
    check_noise(noise_cov, n, "process noise covariance")
    try:
        backward = np.linalg.inv(transition_matrix)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "transition matrix is singular, and information cannot be carried through it: "
            "predict in moment form with kalman.predict"
        ) from error
    M = backward.mT @ information.matrix @ backward
    damping = np.linalg.inv(np.eye(n) + M @ noise_cov)
    matrix = symmetrise(damping @ M)
    vector = multiply(damping @ backward.mT, information.vector)
    return Information(vector + multiply(matrix, np.zeros(n) + control_term), matrix)


def update(
    information: Information,
    measurement: np.ndarray,
    measurement_matrix: np.ndarray,
    noise_cov: np.ndarray,
) -> Information:
    """The information given a measurement z = H x + v: it adds up.

    Args:
        information: vector (..., n), matrix (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken and adds nothing.
        measurement_matrix: H, (m, n) or (..., m, n).
        noise_cov: covariance of v, (m, m) or (..., m, m), positive definite.

    Returns:
        The sum; NaN in a lane whose noise is not positive definite.

    Raises:
        ValueError: the noise does not fit the measurement.
    """
    measurement = np.asarray(measurement, dtype=float)
    check_noise(noise_cov, measurement.shape[-1], "measurement noise covariance")
    H, R = measurement_matrix, noise_cov
    missing = missing_entries(measurement)
    if missing is not None:
        measurement = np.where(missing, 0.0, measurement)
        H = np.where(missing[..., :, None], 0.0, H)
        R = without_rows(R, missing)
    weighted = H.mT @ inverse_spd(R)
    return Information(
        information.vector + multiply(weighted, measurement),
        information.matrix + symmetrise(weighted @ H),
    )
