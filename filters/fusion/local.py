"""No fusion at all: what every rule must beat."""

import numpy as np

from concord.filters.gaussian import Gaussian


def keep_own(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """The node's own belief, the first of mean (..., J, n) and cov (..., J, n, n), bit for bit.

    Promises: consistent whenever the node's filter is, for nothing correlated is ever fused.

    Fails: a node that does not observe the plant by itself drifts with it; on an unstable plant
    without bound.

    Args:
        beliefs: of the node and its neighbours.
        weights: not used; the rules that fuse take them.
    """
    return Gaussian(beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :])
