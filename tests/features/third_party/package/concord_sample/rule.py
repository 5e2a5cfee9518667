"""A rule of beliefs."""

import numpy as np

from concord.filters.gaussian import Gaussian


def widest(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """Fuse beliefs (..., J, n) with weights (..., J) to one belief (..., n)."""
    heard = weights > 0
    share = np.where(heard, weights, 0) / np.where(heard, weights, 0).sum(-1, keepdims=True)
    mean = (share[..., None] * np.where(heard[..., None], beliefs.mean, 0)).sum(-2)
    trace = np.where(heard, np.trace(beliefs.cov, axis1=-2, axis2=-1), -np.inf)
    widest = trace.argmax(-1)[..., None, None, None]
    return Gaussian(mean, np.take_along_axis(beliefs.cov, widest, axis=-3)[..., 0, :, :])
