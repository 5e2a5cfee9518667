"""A Kalman filter by its textbook formulas, on a simulated plant that may differ from its model."""

from typing import NamedTuple

import numpy as np

TRANSITION = np.array([[0.995, 0.0995], [-0.0995, 0.985]])
PROCESS_NOISE = 0.2 * np.array([[0.0003, 0.005], [0.005, 0.1]])
ROWS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]])
NAMES = ("position", "velocity", "position", "position")
NOISE_STD = 0.5


class Planted(NamedTuple):
    """Difference of the plant from the filter's model: factors of variances, and offsets."""

    process: float = 1.0
    noise: tuple[float, ...] = (1.0,) * 4
    offset: tuple[float, ...] = (0.0,) * 4


def innovations(planted: Planted, seed: int, steps: int = 220) -> tuple[np.ndarray, np.ndarray]:
    """Innovations and their variances (steps, 4) of a filter that takes the readings one by one."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(PROCESS_NOISE * planted.process)
    noise_std = NOISE_STD * np.sqrt(planted.noise)
    state, mean, cov = rng.standard_normal(2), np.zeros(2), np.eye(2)
    found, variances = np.empty((2, steps, len(ROWS)))
    for step in range(steps):
        if step:
            state = TRANSITION @ state + root @ rng.standard_normal(2)
            mean, cov = TRANSITION @ mean, TRANSITION @ cov @ TRANSITION.T + PROCESS_NOISE
        for place, row in enumerate(ROWS):
            reading = row @ state + planted.offset[place]
            reading += noise_std[place] * rng.standard_normal()
            variance = row @ cov @ row + NOISE_STD**2
            gain = cov @ row / variance
            found[step, place], variances[step, place] = reading - row @ mean, variance
            mean = mean + gain * found[step, place]
            cov = cov - np.outer(gain, gain) * variance
    return found, variances
