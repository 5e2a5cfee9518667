"""The bootstrap particle filter, in batches: a yardstick that needs no Gaussian belief.

Source: Gordon, Salmond, Smith (1993), Novel approach to nonlinear/non-Gaussian Bayesian state
estimation; resampling is systematic, as in Kitagawa (1996), Monte Carlo filter and smoother.
"""

from typing import NamedTuple

import numpy as np


class Particles(NamedTuple):
    """A weighted cloud per lane: states (..., P, n), log_weights (..., P) up to a constant."""

    states: np.ndarray
    log_weights: np.ndarray


def weights(particles: Particles) -> np.ndarray:
    """Normalised weights (..., P); NaN in a lane where every particle is impossible."""
    logs = particles.log_weights
    with np.errstate(invalid="ignore"):
        worth = np.exp(logs - logs.max(axis=-1, keepdims=True))
    return worth / worth.sum(axis=-1, keepdims=True)


def mean(particles: Particles) -> np.ndarray:
    """The weighted mean (..., n)."""
    return (weights(particles)[..., None] * particles.states).sum(axis=-2)


def cov(particles: Particles) -> np.ndarray:
    """The weighted covariance (..., n, n)."""
    spread = particles.states - mean(particles)[..., None, :]
    return (weights(particles)[..., None] * spread).mT @ spread


def resample(particles: Particles, offset: np.ndarray) -> Particles:
    """Particles of equal weight, drawn systematically with offsets (...) in [0, 1)."""
    count = particles.states.shape[-2]
    edges = np.cumsum(weights(particles), axis=-1)
    # The last edge may fall short of one by rounding; no particle may fall off it.
    edges[..., -1] = 1.0
    places = (np.arange(count) + offset[..., None]) / count
    # All lanes in one sorted row, each lane in an interval of its own.
    lanes = np.arange(offset.size).reshape(offset.shape)[..., None]
    chosen = np.searchsorted((edges + 2 * lanes).ravel(), (places + 2 * lanes).ravel(), "right")
    chosen = np.minimum(chosen.reshape(places.shape) - count * lanes, count - 1)
    states = np.take_along_axis(particles.states, chosen[..., None], axis=-2)
    return Particles(states, np.zeros_like(particles.log_weights))
