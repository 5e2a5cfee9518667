"""Sage-Husa adaptation of everything at once, as the ADLUKF paper prints it: Q, R, and means q, r.

This module reproduces the paper; do not use it for other work. One innovation cannot distinguish Q
from R. The differences in (31) and (33) need not be positive. A mean added to the model absorbs
errors that the state should explain. `sage_husa` adapts R alone and has stronger guarantees.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter, section 3.3, equations 30-35; reconstructed in docs/papers/adlukf.md.
"""

from typing import NamedTuple

import numpy as np

from concord.features.vehicle.adaptive.sage_husa import Bounds, fading_weight

PROCESS_BOUNDS = Bounds(1e-14, 1e2)
MEASUREMENT_BOUNDS = Bounds(1e-8, 1e4)


class NoiseStatistics(NamedTuple):
    """Estimated noise statistics of the paper's filter.

    process_mean q (..., n), process_variances (..., n), measurement_mean r (..., m),
    measurement_variances (..., m), taken (...): readings so far.
    """

    process_mean: np.ndarray
    process_variances: np.ndarray
    measurement_mean: np.ndarray
    measurement_variances: np.ndarray
    taken: np.ndarray


class NoiseEvidence(NamedTuple):
    """Quantities of one step from which the filter estimates its noises.

    Attributes:
        innovation: e (..., m); NaN marks a reading that was not taken.
        correction: K e (..., n), by which the gain moved the state.
        posterior_variances: of the state after it, (..., n).
        process_residual: x - sum Wm f(X) (..., n), of the posterior to the prediction.
        process_spread: variance (..., n) of the predicted points, without noise.
        measurement_residual: z - sum Wm h (..., m).
        measurement_spread: variance (..., m) of the measured points, without noise.
    """

    innovation: np.ndarray
    correction: np.ndarray
    posterior_variances: np.ndarray
    process_residual: np.ndarray
    process_spread: np.ndarray
    measurement_residual: np.ndarray
    measurement_spread: np.ndarray


def begin(process_variances: np.ndarray, measurement_variances: np.ndarray) -> NoiseStatistics:
    """The statistics before the first reading: variances (..., n) and (..., m), means zero."""
    lanes = np.broadcast_shapes(process_variances.shape[:-1], measurement_variances.shape[:-1])
    n, m = process_variances.shape[-1], measurement_variances.shape[-1]
    return NoiseStatistics(
        np.zeros((*lanes, n)),
        np.broadcast_to(process_variances, (*lanes, n)),
        np.zeros((*lanes, m)),
        np.broadcast_to(measurement_variances, (*lanes, m)),
        np.zeros(lanes),
    )


def adapt(
    noise: NoiseStatistics,
    evidence: NoiseEvidence,
    *,
    forgetting: float = 0.97,
    means: bool = False,
    process_bounds: Bounds = PROCESS_BOUNDS,
    measurement_bounds: Bounds = MEASUREMENT_BOUNDS,
) -> NoiseStatistics:
    """The statistics after one step more: (31), (33)-(35) and, with `means`, (30) and (32).

    The diagonal that the paper keeps may be negative: its absolute value is taken, within bounds. A
    step in which an entry was not taken, or that failed, changes nothing of the same kind.

    Raises:
        ValueError: forgetting is not between 0 and 1.
    """
    weight = fading_weight(noise.taken, forgetting)[..., None]
    process = (
        evidence.correction**2 + evidence.posterior_variances - evidence.process_spread
    )  # (31), (34)
    measured = evidence.innovation**2 - evidence.measurement_spread  # (33), (35)
    complete = np.asarray(np.isfinite(evidence.innovation).all(axis=-1, keepdims=True))
    process = np.where(complete, process, np.nan)
    statistics = noise._replace(
        process_variances=_mixed(noise.process_variances, process, weight, process_bounds),
        measurement_variances=_mixed(
            noise.measurement_variances, measured, weight, measurement_bounds
        ),
        taken=noise.taken + complete[..., 0],
    )
    if not means:
        return statistics
    return statistics._replace(
        process_mean=_faded(noise.process_mean, evidence.process_residual, weight),  # (30)
        measurement_mean=_faded(
            noise.measurement_mean, evidence.measurement_residual, weight
        ),  # (32)
    )


def _faded(past: np.ndarray, sample: np.ndarray, weight: np.ndarray) -> np.ndarray:
    taken = np.isfinite(sample)
    return past + np.where(taken, weight * (np.where(taken, sample, 0.0) - past), 0.0)


def _mixed(past: np.ndarray, sample: np.ndarray, weight: np.ndarray, bounds: Bounds) -> np.ndarray:
    return np.clip(np.abs(_faded(past, sample, weight)), bounds.low, bounds.high)
