"""The Kalman filter with given matrices, in Joseph's form: the reference for all others.

Source: Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, chapter 5; Joseph's form keeps the covariance positive definite whatever the error of
the gain.
"""

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import multiply, solve_spd, symmetrise
from filters.moments import check_noise
from filters.update import Update, missing_entries, settle, without_rows


def predict(
    belief: Gaussian,
    transition_matrix: np.ndarray,
    noise_cov: np.ndarray,
    control_term: np.ndarray | float = 0.0,
) -> Gaussian:
    """The belief one step later: x = F x + G u + w.

    Args:
        belief: mean (..., n), cov (..., n, n).
        transition_matrix: F, (n, n) or (..., n, n).
        noise_cov: covariance of w, (n, n) or (..., n, n).
        control_term: G u, (..., n).

    Raises:
        ValueError: the noise does not fit the state.
    """
    check_noise(noise_cov, belief.mean.shape[-1], "process noise covariance")
    F = transition_matrix
    mean = multiply(F, belief.mean) + control_term
    return Gaussian(mean, symmetrise(F @ belief.cov @ F.mT + noise_cov))


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measurement_matrix: np.ndarray,
    noise_cov: np.ndarray,
    *,
    gate: float | None = None,
) -> Update:
    """The belief given a measurement z = H x + v.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        measurement_matrix: H, (m, n) or (..., m, n).
        noise_cov: covariance of v, (m, m) or (..., m, m).
        gate: lanes whose normalised innovation squared exceeds it keep their belief.

    Returns:
        An Update; NaN in a lane whose innovation covariance is not positive definite. A lane with
        nothing taken, or gated out, keeps its belief bit for bit.

    Raises:
        ValueError: the noise does not fit the measurement.
    """
    measurement = np.asarray(measurement, dtype=float)
    innovation = measurement - multiply(measurement_matrix, belief.mean)
    missing = missing_entries(measurement)
    return linear_update(belief, innovation, measurement_matrix, noise_cov, missing, gate)


def linear_update(
    belief: Gaussian,
    innovation: np.ndarray,
    measurement_matrix: np.ndarray,
    noise_cov: np.ndarray,
    missing: np.ndarray | None,
    gate: float | None,
) -> Update:
    """The Update by an innovation (..., m) that depends on the state through a matrix (..., m, n).

    Entries marked in `missing` (..., m), as `update.missing_entries` gives it, are left out.

    Raises:
        ValueError: the noise does not fit the measurement.
    """
    check_noise(noise_cov, innovation.shape[-1], "measurement noise covariance")
    H, R, P = measurement_matrix, noise_cov, belief.cov
    if missing is not None:
        innovation = np.where(missing, 0.0, innovation)
        H = np.where(missing[..., :, None], 0.0, H)
        R = without_rows(R, missing)
    S = symmetrise(H @ P @ H.mT + R)
    K = solve_spd(S, H @ P).mT
    left = np.eye(P.shape[-1]) - K @ H
    cov = symmetrise(left @ P @ left.mT + K @ R @ K.mT)
    after = Gaussian(belief.mean + multiply(K, innovation), cov)
    squared = np.vecdot(innovation, solve_spd(S, innovation[..., None])[..., 0])
    return settle(belief, after, innovation, S, squared, missing, gate)
