"""Sage-Husa adaptation: noise of independent channels, estimated from what a filter leaves over.

The estimate is a value that travels with the belief. Only the measurement noise is adapted here,
in residual form: the part of the reading that the posterior does not explain, plus the posterior's
own spread, is positive however it is rounded. (Process noise adapted at the same time cannot be
told apart from it; `concord.papers.adlukf.sage_husa_as_printed` does so because a paper does.)

Sources: Sage and Husa (1969), Adaptive filtering with unknown prior statistics (the fading
average); Mohamed and Schwarz (1999), Adaptive Kalman filtering for INS/GPS, equation 18 (the
residual form).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.adaptive.noise_law import ReadingEvidence
from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual, evaluate, moments
from concord.filters.sigma_points import SigmaPointRule, sigma_points


class NoiseEstimate(NamedTuple):
    """Independent measurement noises as a filter believes them now.

    variances (..., m); taken (..., m), how many readings of each channel were taken so far.
    """

    variances: np.ndarray
    taken: np.ndarray

    @property
    def cov(self) -> np.ndarray:
        """R (..., m, m)."""
        return self.variances[..., None] * np.eye(self.variances.shape[-1])


class Bounds(NamedTuple):
    """Absolute limits of a variance, in the units of the measurement squared; arrays (..., m) too.

    Limits relative to the start would keep the filter from leaving a wrong one. No number suits the
    units of every sensor, so there is no limit unless one is given.
    """

    low: np.ndarray | float = 0.0
    high: np.ndarray | float = np.inf


UNBOUNDED = Bounds()


def begin(variances: np.ndarray) -> NoiseEstimate:
    """The estimate before the first reading, variances (..., m).

    Raises:
        ValueError: a variance is not positive.
    """
    variances = np.asarray(variances, dtype=float)
    if not (variances > 0).all():
        raise ValueError(
            f"starting variances are {variances}, but an adaptive filter needs positive ones: "
            "give the sensor's data-sheet values"
        )
    return NoiseEstimate(variances, np.zeros(variances.shape))


def fading_weight(taken: np.ndarray, forgetting: float) -> np.ndarray:
    """Weight d = (1 - b) / (1 - b^(k + 1)) of the k-th reading, k = taken + 1, for forgetting b.

    It falls from 1 / (1 + b) to 1 - b, so the start has the weight of one reading.

    Raises:
        ValueError: forgetting is not between 0 and 1.
    """
    if not 0 < forgetting < 1:
        raise ValueError(
            f"forgetting is {forgetting}, but must lie between 0 and 1: choose .95 to .99"
        )
    return (1 - forgetting) / (1 - forgetting ** (taken + 2))


def adapt(
    noise: NoiseEstimate,
    residual: np.ndarray,
    spread: np.ndarray,
    *,
    forgetting: float = 0.98,
    bounds: Bounds = UNBOUNDED,
    outlier_limit: float | None = None,
) -> NoiseEstimate:
    """The estimate after one reading more: R <- (1 - d) R + d (residual^2 + spread).

    Args:
        noise: the estimate so far.
        residual: (..., m), reading minus what the posterior predicts; NaN leaves a channel alone.
        spread: (..., m), variance of that prediction.
        forgetting: b, the weight of the past.
        bounds: limits of every variance.
        outlier_limit: a reading counts as at most this many times the present variance; None takes
            it as it is.

    Raises:
        ValueError: forgetting is not between 0 and 1.
    """
    weight = fading_weight(noise.taken, forgetting)
    sample = residual**2 + spread
    if outlier_limit is not None:
        sample = np.minimum(sample, outlier_limit * noise.variances)
    taken = np.isfinite(sample)
    mixed = noise.variances + weight * (np.where(taken, sample, 0.0) - noise.variances)
    variances = np.where(taken, np.clip(mixed, bounds.low, bounds.high), noise.variances)
    return NoiseEstimate(variances, noise.taken + taken)


@dataclass(frozen=True)
class SageHusa:
    """`adapt` as a `noise_law.NoiseLaw`; limits are factors of the
    variance of the data sheet."""

    forgetting: float = 0.98
    bounds: Bounds = UNBOUNDED
    outlier_limit: float | None = None

    def begin(self, shape: tuple[int, ...]) -> NoiseEstimate:
        """The data sheet."""
        return begin(np.ones(shape))

    def factors(self, memory: NoiseEstimate) -> np.ndarray:
        """Variances learnt over those of the data sheet, (..., m)."""
        return memory.variances

    def adapt(self, memory: NoiseEstimate, evidence: ReadingEvidence) -> NoiseEstimate:
        """The memory after one reading more."""
        return adapt(
            memory,
            *evidence.unexplained(),
            forgetting=self.forgetting,
            bounds=self.bounds,
            outlier_limit=self.outlier_limit,
        )


def unexplained(
    posterior: Gaussian,
    measurement: np.ndarray,
    measure: Model,
    rule: SigmaPointRule,
    residual: Residual = np.subtract,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the unexplained rest of a reading: residual (..., m), spread (..., m) of `adapt`.

    Args:
        posterior: mean (..., n), cov (..., n, n), with the reading taken.
        measurement: (..., m); an entry that is NaN was not taken, and neither is its residual.
        measure: points (S, ..., n) -> predicted measurements (S, ..., m).
        rule: a sigma-point rule for n dimensions.
        residual: difference of two measurements, for measurements with angles.
    """
    measurement = np.asarray(measurement, dtype=float)
    points = sigma_points(posterior, rule)
    values = evaluate(measure, points, measurement.shape[-1], "measure")
    predicted, deviations = moments(values, rule, residual)
    missing = np.isnan(measurement)
    left = residual(np.where(missing, predicted, measurement), predicted)
    spread = (rule.cov_weights[:, None] * deviations**2).sum(axis=-2)
    # A rule with negative weights may give a strongly curved measurement a negative spread.
    return np.where(missing, np.nan, left), np.maximum(spread, 0.0)
