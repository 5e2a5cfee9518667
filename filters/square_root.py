"""The unscented Kalman filter on square roots: `ukf` with cov = factor @ factor.T throughout.

A joint factor of (measurement, state) is found in one triangularisation; its blocks are the factor
of the innovation covariance, the whitened gain and the posterior factor. Points of negative weight
are taken out again by a rank-one down-date.

Sources: Arasaratnam and Haykin (2009), Cubature Kalman filters, the square-root form (the
triangularisation); Van der Merwe and Wan (2001), The square-root unscented Kalman filter (the
down-date).
"""

import numpy as np

from filters.gaussian import SquareRootGaussian
from filters.linalg import lose_failed, multiply
from filters.moments import Model, Residual, check_noise, evaluate, moments, points_last
from filters.sigma_points import SigmaPointRule, spread_points
from filters.update import Update, missing_entries, settle


def predict(
    belief: SquareRootGaussian,
    transition: Model,
    noise_factor: np.ndarray,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
) -> SquareRootGaussian:
    """The belief one step later; see `ukf.predict`.

    Args:
        belief: mean (..., n), factor (..., n, n).
        transition: points (S, ..., n) -> points (S, ..., n).
        noise_factor: (n, n) or (..., n, n), any square root: noise_factor @ noise_factor.T = Q.
        rule: a sigma-point rule for n dimensions.
        residual: difference of two states, for states with angles.

    Returns:
        The predicted belief; NaN in a lane that has lost positive definiteness.

    Raises:
        ValueError: the rule, the noise or the model's values do not fit the state.
    """
    n = belief.mean.shape[-1]
    check_noise(noise_factor, n, "process noise factor")
    points = spread_points(belief.mean, belief.factor, rule)
    mean, deviations = moments(evaluate(transition, points, n, "transition"), rule, residual)
    return SquareRootGaussian(mean, _factor_of(deviations, rule.cov_weights, noise_factor.mT))


def update(
    belief: SquareRootGaussian,
    measurement: np.ndarray,
    measure: Model,
    noise_factor: np.ndarray,
    rule: SigmaPointRule,
    *,
    residual: Residual = np.subtract,
    state_residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update[SquareRootGaussian]:
    """The belief given a measurement; see `ukf.update`.

    Args:
        belief: mean (..., n), factor (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        measure: points (S, ..., n) -> predicted measurements (S, ..., m).
        noise_factor: (m, m) or (..., m, m), any square root: noise_factor @ noise_factor.T = R.
        rule: a sigma-point rule for n dimensions.
        residual: difference of two measurements, for measurements with angles.
        state_residual: difference of two states; it matters only where the points spread over more
            than half a turn of an angle.
        gate: lanes whose normalised innovation squared exceeds it keep their belief.

    Returns:
        An Update; NaN in a lane that has lost positive definiteness, or whose innovation covariance
        is singular.

    Raises:
        ValueError: the rule, the noise, the measurement or the model's values do not fit.
    """
    measurement = np.asarray(measurement, dtype=float)
    m = measurement.shape[-1]
    check_noise(noise_factor, m, "measurement noise factor")
    points = spread_points(belief.mean, belief.factor, rule)
    predicted, deviations = moments(evaluate(measure, points, m, "measure"), rule, residual)
    state_deviations = points_last(state_residual(points, belief.mean))
    innovation, noise_rows = residual(measurement, predicted), noise_factor.mT

    missing = missing_entries(measurement)
    if missing is not None:
        # A row that was not taken: no deviation, no innovation, an independent unit noise.
        innovation = np.where(missing, 0.0, innovation)
        deviations = np.where(missing[..., None, :], 0.0, deviations)
        noise_rows = np.where(missing[..., None, :], 0.0, noise_rows)
        noise_rows = _stack_rows(noise_rows, missing[..., None, :] * np.eye(m))

    joint = _join_columns(deviations, state_deviations)
    no_state_noise = np.zeros((*noise_rows.shape[:-1], state_deviations.shape[-1]))
    noise_rows = _join_columns(noise_rows, no_state_noise)
    factor = _factor_of(joint, rule.cov_weights, noise_rows)
    innovation_factor, gain, posterior = (
        factor[..., :m, :m],
        factor[..., m:, :m],
        factor[..., m:, m:],
    )

    pivots = np.diagonal(innovation_factor, axis1=-2, axis2=-1)
    singular = np.any(pivots == 0, axis=-1, keepdims=True)[..., None]
    whitener = np.linalg.inv(np.where(singular, np.nan, innovation_factor))
    whitened = multiply(whitener, innovation)
    after = SquareRootGaussian(belief.mean + multiply(gain, whitened), posterior)
    innovation_cov = innovation_factor @ innovation_factor.mT
    squared = np.vecdot(whitened, whitened)
    return settle(belief, after, innovation, innovation_cov, squared, missing, gate)


def triangularise(rows: np.ndarray) -> np.ndarray:
    """Lower triangular factor (..., n, n), pivots >= 0, of rows.T @ rows; rows (..., r >= n, n)."""
    factor = np.asarray(np.linalg.qr(rows, mode="r")).mT
    pivots = np.diagonal(factor, axis1=-2, axis2=-1)
    return lose_failed(factor * np.where(pivots < 0, -1.0, 1.0)[..., None, :])


def downdate(factor: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Lower triangular factor (..., n, n) of factor @ factor.T - vector @ vector.T.

    A lane in which the difference is not positive definite is NaN.

    Source: Bojanczyk, Brent, Van Dooren and de Hoog (1987), A note on downdating the Cholesky
    factorization: hyperbolic rotations in mixed form, the stable one.
    """
    factor, vector = factor.copy(), vector.copy()
    for k in range(factor.shape[-1]):
        pivot, entry = factor[..., k, k], vector[..., k]
        squared = (pivot - entry) * (pivot + entry)
        pivot_after = np.sqrt(np.where(squared > 0, squared, np.nan))
        cosine = (pivot_after / pivot)[..., None]
        sine = (entry / pivot)[..., None]
        factor[..., k, k] = pivot_after
        below = (factor[..., k + 1 :, k] - sine * vector[..., k + 1 :]) / cosine
        factor[..., k + 1 :, k] = below
        vector[..., k + 1 :] = cosine * vector[..., k + 1 :] - sine * below
    return lose_failed(factor)


def _factor_of(deviations: np.ndarray, weights: np.ndarray, noise_rows: np.ndarray) -> np.ndarray:
    """Factor of sum w_s d_s d_s' + noise_rows' noise_rows, deviations (..., S, k)."""
    scaled = np.sqrt(np.abs(weights))[:, None] * deviations
    factor = triangularise(_stack_rows(scaled[..., weights >= 0, :], noise_rows))
    for s in np.flatnonzero(weights < 0):
        factor = downdate(factor, scaled[..., s, :])
    return factor


def _stack_rows(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Concatenate along the rows, (..., r, k), with free leading axes."""
    lanes = np.broadcast_shapes(above.shape[:-2], below.shape[:-2])
    parts = [np.broadcast_to(part, (*lanes, *part.shape[-2:])) for part in (above, below)]
    return np.concatenate(parts, axis=-2)


def _join_columns(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Concatenate along the columns, (..., r, k), with free leading axes."""
    return _stack_rows(left.mT, right.mT).mT
