"""A Gaussian conditioned on a measurement, given its joint moments with what was measured."""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import (
    cholesky,
    inverse_of_triangle,
    lanes_last,
    multiply,
    times_transposed,
)
from concord.filters.moments import Residual
from concord.filters.update import Update, missing_entries, settle, without_rows


def condition(
    belief: Gaussian,
    measurement: np.ndarray,
    predicted: np.ndarray,
    innovation_cov: np.ndarray,
    cross_cov: np.ndarray,
    residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update:
    """The belief given a measurement, from moments that some rule has found.

    Args:
        belief: mean (..., n), cov (..., n, n).
        measurement: (..., m); an entry that is NaN was not taken.
        predicted: its mean (..., m).
        innovation_cov: its covariance (..., m, m), noise included.
        cross_cov: of state and measurement, (..., n, m).
        residual: difference of two measurements, for measurements with angles.
        gate: lanes whose normalised innovation squared exceeds it keep their belief.

    Returns:
        An Update as of `ukf.update`; NaN in a lane whose innovation covariance is not positive
        definite.
    """
    measurement = lanes_last(measurement, 1)
    missing = missing_entries(measurement)
    if missing is None:
        innovation = residual(measurement, predicted)
    else:
        taken = np.where(missing, predicted, measurement)
        innovation = np.where(missing, 0.0, residual(taken, predicted))
        innovation_cov = without_rows(innovation_cov, missing)
        cross_cov = np.where(missing[..., None, :], 0.0, cross_cov)
    # With S = F F' and G = K F = C F^-T, P - K S K' is P - G G', which stays symmetric.
    whitener = inverse_of_triangle(cholesky(innovation_cov))
    whitened = multiply(whitener, innovation)
    gain = times_transposed(cross_cov, whitener)
    after = Gaussian(
        belief.mean + multiply(gain, whitened), belief.cov - times_transposed(gain, gain)
    )
    squared = np.vecdot(whitened, whitened)
    return settle(belief, after, innovation, innovation_cov, squared, missing, gate)
