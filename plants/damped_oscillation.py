"""The damped oscillation x'' = -w^2 (x - c) - g x' + white noise, exactly discretised.

Closed form instead of a matrix exponential, so that a node process needs numpy only.
"""

import math

import numpy as np

from concord.plants.motion import require_positive


def oscillation_transition(
    frequency_rad_s: float, damping_1_s: float, time_step_s: float
) -> np.ndarray:
    """Matrix (2, 2) that carries [x - c, x'] by one step.

    `frequency_rad_s` is the undamped w, `damping_1_s` is g.

    Raises:
        ValueError: for values that are not positive, or damping that prevents an oscillation.
    """
    require_positive(
        frequency_rad_s=frequency_rad_s, damping_1_s=damping_1_s, time_step_s=time_step_s
    )
    if damping_1_s >= 2 * frequency_rad_s:
        raise ValueError(
            f"damping_1_s is {damping_1_s:g}, but must be below twice the frequency "
            f"{frequency_rad_s:g} rad/s (underdamped); lower the damping"
        )
    decay = damping_1_s / 2
    ringing = math.sqrt(frequency_rad_s**2 - decay**2)
    envelope = math.exp(-decay * time_step_s)
    cosine = envelope * math.cos(ringing * time_step_s)
    sine = envelope * math.sin(ringing * time_step_s) / ringing
    return np.array(
        [
            [cosine + decay * sine, sine],
            [-(frequency_rad_s**2) * sine, cosine - decay * sine],
        ]
    )


def stationary_cov(frequency_rad_s: float, velocity_std: float) -> np.ndarray:
    """Covariance (2, 2) of [x, x'] in the long run: each holds half of the mean energy."""
    return np.diag([(velocity_std / frequency_rad_s) ** 2, velocity_std**2])


def oscillation_noise_cov(transition: np.ndarray, stationary: np.ndarray) -> np.ndarray:
    """Covariance (2, 2) that a step adds: what keeps the stationary covariance stationary.

    It belongs to white noise of spectral density 2 g velocity_std^2.
    """
    lost = stationary - transition @ stationary @ transition.T
    return (lost + lost.T) / 2
