"""A Kalman filter by its textbook formulas, on a simulated plant that may differ from its model."""

from typing import NamedTuple

import numpy as np

TRANSITION = np.array([[0.995, 0.0995], [-0.0995, 0.985]])
PROCESS_NOISE = 0.2 * np.array([[0.0003, 0.005], [0.005, 0.1]])
ROWS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]])
NAMES = ("position", "velocity", "position", "position")
NOISE_STD = 0.5


class Planted(NamedTuple):
    """Difference of the plant from the filter's model: factors of variances, and offsets.

    `process` is the plant's factor of the process noise, `believed_process` that of the filter.
    """

    process: float = 1.0
    believed_process: float = 1.0
    noise: tuple[float, ...] = (1.0,) * 4
    offset: tuple[float, ...] = (0.0,) * 4


def innovations(planted: Planted, runs: int, steps: int = 220) -> tuple[np.ndarray, np.ndarray]:
    """Innovations (runs, steps, 4) of a filter that takes the readings one by one, and their
    variances (steps, 4), which are those of all runs."""
    rng = np.random.default_rng(1)
    root = np.linalg.cholesky(PROCESS_NOISE * planted.process)
    noise_std = NOISE_STD * np.sqrt(planted.noise)
    believed = PROCESS_NOISE * planted.believed_process
    state, mean, cov = rng.standard_normal((runs, 2)), np.zeros((runs, 2)), np.eye(2)
    found, variances = np.empty((runs, steps, len(ROWS))), np.empty((steps, len(ROWS)))
    for step in range(steps):
        if step:
            state = state @ TRANSITION.T + rng.standard_normal((runs, 2)) @ root.T
            mean, cov = mean @ TRANSITION.T, TRANSITION @ cov @ TRANSITION.T + believed
        for place, row in enumerate(ROWS):
            reading = state @ row + planted.offset[place]
            reading += noise_std[place] * rng.standard_normal(runs)
            variance = row @ cov @ row + NOISE_STD**2
            gain = cov @ row / variance
            found[:, step, place], variances[step, place] = reading - mean @ row, variance
            mean = mean + found[:, step, place, None] * gain
            cov = cov - np.outer(gain, gain) * variance
    return found, variances
