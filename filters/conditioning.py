"""A Gaussian conditioned on a measurement, given its joint moments with what was measured."""

import numpy as np

from filters.gaussian import Gaussian
from filters.moments import Residual
from filters.paths import path_of_correction
from filters.update import Update, missing_entries, settle, without_rows


def condition(
    belief: Gaussian,
    measurement: np.ndarray,
    predicted: np.ndarray,
    innovation_cov: np.ndarray,
    cross_cov: np.ndarray,
    residual: Residual = np.subtract,
    gate: float | None = None,
) -> Update[Gaussian]:
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
    missing = missing_entries(measurement)
    if missing is None:
        innovation = residual(measurement, predicted)
    else:
        taken = np.where(missing, predicted, measurement)
        innovation = np.where(missing, 0.0, residual(taken, predicted))
        innovation_cov = without_rows(innovation_cov, missing)
        cross_cov = np.where(missing[..., None, :], 0.0, cross_cov)
    correct = path_of_correction(belief, innovation).correct
    after, squared = correct(belief, innovation, innovation_cov, cross_cov)
    return settle(belief, after, innovation, innovation_cov, squared, missing, gate)
