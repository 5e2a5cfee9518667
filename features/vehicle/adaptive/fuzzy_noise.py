"""Fuzzy covariance matching: R follows how large innovations are beside what the filter expects.

Each channel has a ratio: the mean square of the last innovations over its predicted variance. The
ratio is small, equal or large. A Sugeno rule base turns it into a factor for the channel's
variance. The caller keeps the estimate of R beside the belief.

Source: Escamilla-Ambrosio and Mort (2003), Hybrid Kalman filter-fuzzy logic adaptive multisensor
data fusion architectures (covariance matching with a fuzzy rule base). Sets and factors are chosen
here, for the paper that compares with such a filter gives none.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.adaptive.noise_law import ReadingEvidence
from concord.features.vehicle.adaptive.sage_husa import UNBOUNDED, Bounds

WINDOW = 30
"""Innovations of a channel that are looked back on, unless a caller says."""

SHRINK, KEEP, GROW = 0.9, 1.0, 1.1
"""Factors of the rules: small, equal and large."""


class FuzzyNoise(NamedTuple):
    """Variances (..., m), and the squared innovations last seen (..., window, m), NaN for none."""

    variances: np.ndarray
    squared: np.ndarray

    @property
    def cov(self) -> np.ndarray:
        """R (..., m, m)."""
        return self.variances[..., None] * np.eye(self.variances.shape[-1])


def begin(variances: np.ndarray, window: int = WINDOW) -> FuzzyNoise:
    """The estimate before the first reading, variances (..., m)."""
    variances = np.asarray(variances, dtype=float)
    lanes, m = variances.shape[:-1], variances.shape[-1]
    return FuzzyNoise(variances, np.full((*lanes, window, m), np.nan))


def adapt(
    noise: FuzzyNoise,
    innovation: np.ndarray,
    expected: np.ndarray,
    bounds: Bounds = UNBOUNDED,
) -> FuzzyNoise:
    """The estimate after one reading more.

    A channel waits until its window is full. NaN innovations leave a channel alone.

    Args:
        noise: the estimate so far.
        innovation: (..., m); NaN was not taken.
        expected: variances of the innovations that the filter expected, (..., m).
        bounds: limits of every variance.
    """
    taken = np.isfinite(innovation)
    squared = np.broadcast_to(noise.squared, (*innovation.shape[:-1], *noise.squared.shape[-2:]))
    shifted = np.concatenate([squared[..., 1:, :], innovation[..., None, :] ** 2], axis=-2)
    squared = np.where(taken[..., None, :], shifted, squared)
    # Not a number until the window is full, and wherever the filter expects nothing sensible.
    sensible = taken & (expected > 0)
    ratio = squared.mean(axis=-2) / np.where(sensible, expected, np.nan)
    scale = np.where(np.isfinite(ratio), factor(ratio), KEEP)
    variances = np.where(
        taken, np.clip(scale * noise.variances, bounds.low, bounds.high), noise.variances
    )
    return FuzzyNoise(variances, squared)


@dataclass(frozen=True)
class FuzzyMatching:
    """`adapt` as a `noise_law.NoiseLaw`; limits are factors of the
    variance of the data sheet."""

    window: int = WINDOW
    bounds: Bounds = UNBOUNDED

    def begin(self, shape: tuple[int, ...]) -> FuzzyNoise:
        """The data sheet."""
        return begin(np.ones(shape), self.window)

    def factors(self, memory: FuzzyNoise) -> np.ndarray:
        """Variances learnt over those of the data sheet, (..., m)."""
        return memory.variances

    def adapt(self, memory: FuzzyNoise, evidence: ReadingEvidence) -> FuzzyNoise:
        """The memory after one reading more."""
        return adapt(memory, evidence.innovation, evidence.expected, self.bounds)


def factor(ratio: np.ndarray) -> np.ndarray:
    """Return the factor (...) of a variance for a ratio (...) of found to expected.

    Small is 1 up to .5 and 0 from 1 on, large is 0 up to 1 and 1 from 2 on, equal is the rest.
    """
    small = np.clip(2.0 * (1.0 - ratio), 0.0, 1.0)
    large = np.clip(ratio - 1.0, 0.0, 1.0)
    return SHRINK * small + GROW * large + KEEP * (1.0 - small - large)
