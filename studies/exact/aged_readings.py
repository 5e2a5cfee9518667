"""Error covariances of a linear filter to which readings of some sensors come late.

No estimator has less error: its readings are all those that have come, and the Kalman filter with
these is the best one (Kalman 1960). Late readings are fused in the order in which they were taken.
"""

import numpy as np

from concord.filters.linalg import symmetrise
from concord.studies.exact.averaged_errors import LinearNetwork

# Iterations of the Riccati equation, and the relative change at which it has settled.
_MOST_STEPS, _SETTLED = 100_000, 1e-13
# A covariance that has grown so many times grows without bound.
_UNBOUNDED = 1e30


def steady_cov(network: LinearNetwork) -> np.ndarray:
    """Return the covariance (n, n) after a reading of all sensors in each of many steps.

    Raises:
        ValueError: the error grows without bound, as the sensors do not see all of the plant.
    """
    n = len(network.transition_matrix)
    everything = np.ones(len(network.information))
    cov = np.eye(n)
    for _ in range(_MOST_STEPS):
        after = _step(network, cov, everything)
        if np.abs(after - cov).max() <= _SETTLED * np.abs(after).max():
            return after
        if after.max() > _UNBOUNDED * network.noise_cov.max():
            break
        cov = after
    raise ValueError(
        f"the error of a filter that hears all {len(network.information)} sensors does not settle; "
        "use sensors that see the whole state"
    )


def aged_cov(network: LinearNetwork, steady: np.ndarray, ages: np.ndarray) -> np.ndarray:
    """Return the covariances (..., n, n) of filters that lack the newest readings of each sensor.

    Args:
        steady: of `steady_cov`.
        ages: (..., N), whole numbers: how many of the last readings of each sensor are missing.
    """
    cov = np.broadcast_to(steady, (*ages.shape[:-1], *steady.shape))
    for left in range(int(ages.max(initial=0)) - 1, -1, -1):
        # A lane whose readings have all come is at the steady covariance, and stays there.
        cov = _step(network, cov, (ages <= left).astype(float))
    return cov


def _step(network: LinearNetwork, cov: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """Return the covariances after a step in which the sensors `heard` (..., N) are read."""
    F = network.transition_matrix
    predicted = symmetrise(F @ cov @ F.mT + network.noise_cov)
    told = np.tensordot(heard, network.information, axes=1)
    # I - P J, with P + P J P = P (I + J P): no inverse of a covariance, which may be singular.
    eye = np.eye(len(F))
    return symmetrise(np.linalg.solve(eye + predicted @ told, predicted))
