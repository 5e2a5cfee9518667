"""The Kalman filter with given matrices, in Joseph's form: the reference for all others.

Source: Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, chapter 5; Joseph's form keeps the covariance positive definite whatever the error of
the gain.
"""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply, solve_spd, symmetrise
from concord.filters.update import Update, missing_entries, settle, without_rows


def predict(
    belief: Gaussian,
    transition_matrix: np.ndarray,
    noise_cov: np.ndarray,
    control_term: np.ndarray | float = 0.0,
) -> Gaussian:
    """The belief one step later: x = F x + G u + w.

    F and the covariance of w are (n, n) or (..., n, n), and the control term G u is (..., n).
    """
    F = transition_matrix
    mean = multiply(F, belief.mean) + control_term
    return Gaussian(mean, symmetrise(F @ belief.cov @ F.mT + noise_cov))


def update(
    belief: Gaussian,
    measurement: np.ndarray,
    measurement_matrix: np.ndarray,
    noise_cov: np.ndarray,
) -> Update:
    """The belief (..., n) given a measurement z = H x + v (..., m); a NaN entry was not taken.

    H is (m, n) or (..., m, n), and the covariance of v is (m, m) or (..., m, m).
    """
    measurement = np.asarray(measurement, dtype=float)
    innovation = measurement - multiply(measurement_matrix, belief.mean)
    missing = missing_entries(measurement)
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
    return settle(belief, after, innovation, S, squared, missing, None)
