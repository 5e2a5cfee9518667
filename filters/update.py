"""Result of a measurement update; helpers for missing entries and for lanes that keep a belief."""

import math
from typing import NamedTuple

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


class Update(NamedTuple):
    """The belief after a measurement, and what the measurement said.

    Attributes:
        belief: after the update; in lanes with nothing taken, or gated out, the one before.
        innovation: (..., m), measurement minus prediction; NaN in the entries not taken.
        innovation_cov: (..., m, m), its covariance; NaN in the rows and columns not taken.
        normalised_innovation_squared: (...), over the entries taken; 0 where there were none. With
            a matched filter it is chi-square with as many degrees of freedom as entries taken.
    """

    belief: Gaussian
    innovation: np.ndarray
    innovation_cov: np.ndarray
    normalised_innovation_squared: np.ndarray


def chosen(lanes: np.ndarray, one: Update, other: Update) -> Update:
    """`one` in these lanes (...), `other` elsewhere."""
    if not lanes.any():
        return other
    column, matrix = lanes[..., None], lanes[..., None, None]
    return Update(
        Gaussian(
            np.where(column, one.belief.mean, other.belief.mean),
            np.where(matrix, one.belief.cov, other.belief.cov),
        ),
        np.where(column, one.innovation, other.innovation),
        np.where(matrix, one.innovation_cov, other.innovation_cov),
        np.where(lanes, one.normalised_innovation_squared, other.normalised_innovation_squared),
    )


def missing_entries(measurement: np.ndarray) -> np.ndarray | None:
    """True (..., m) where an entry is NaN, that is, was not taken; None when all were."""
    if measurement.ndim == 1 and not math.isnan(measurement.dot(measurement)):
        return None
    missing = np.isnan(measurement)
    return missing if missing.any() else None


def without_rows(cov: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Covariance (..., m, m) whose missing rows (..., m) are independent unit variances.

    With zero cross-covariance such a row drops out of the algebra exactly, so lanes with different
    rows missing stay one batch.
    """
    either = missing[..., :, None] | missing[..., None, :]
    return np.where(either, np.eye(missing.shape[-1]), cov)


def settle(
    before: Gaussian,
    after: Gaussian,
    innovation: np.ndarray,
    innovation_cov: np.ndarray,
    normalised_innovation_squared: np.ndarray,
    missing: np.ndarray | None,
    gate: float | None,
) -> Update:
    """The Update, with the belief before in lanes with nothing taken or beyond the gate."""
    kept = None
    if missing is not None:
        either = missing[..., :, None] | missing[..., None, :]
        innovation = np.where(missing, np.nan, innovation)
        innovation_cov = np.where(either, np.nan, innovation_cov)
        kept = np.asarray(missing.all(axis=-1))
    if gate is not None:
        rejected = np.asarray(normalised_innovation_squared > gate)
        kept = rejected if kept is None else kept | rejected
    if kept is not None and kept.any():
        after = Gaussian(
            np.where(kept[..., None], before[0], after[0]),
            np.where(kept[..., None, None], before[1], after[1]),
        )
    return Update(after, innovation, innovation_cov, normalised_innovation_squared)


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
