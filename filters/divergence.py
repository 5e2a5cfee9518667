"""The distance from one belief to another, as the information that the first has more."""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.linalg import solve_spd


def kullback_leibler(belief: Gaussian, predicted: Gaussian) -> np.ndarray:
    """Return the Kullback-Leibler divergence (...) of beliefs (..., n) from others, in nats.

    It is 0 where both are equal, and NaN or infinite where a covariance is not positive definite.
    Source: Kullback (1959), Information theory and statistics, section 9.1.
    """
    change = (belief.mean - predicted.mean)[..., None]
    shift = (change * solve_spd(predicted.cov, change)).sum(axis=(-1, -2))
    ratio = np.trace(solve_spd(predicted.cov, belief.cov), axis1=-2, axis2=-1)
    volumes = np.linalg.slogdet(predicted.cov)[1] - np.linalg.slogdet(belief.cov)[1]
    return 0.5 * (shift + ratio - belief.mean.shape[-1] + volumes)
