"""Diffusion Kalman filtering: exchange readings once, then average estimates and not covariances.

Source: Cattivelli and Sayed (2010), Diffusion strategies for distributed Kalman filtering and
smoothing, IEEE Trans. Automatic Control 55(9), algorithm 1. Its incremental update by the
neighbours' readings is here `novelty.absorb` of their novelties, which is the same for linear
sensors and lets each node interpret its own.
"""

import numpy as np

from concord.filters.fusion.novelty import absorb, novelty
from concord.filters.fusion.packed import average, pack, packed_length, unpack
from concord.filters.gaussian import Gaussian


def begin(prior: Gaussian, posterior: Gaussian) -> np.ndarray:
    """Return the node's share of the first round: its novelty, packed (..., n + n (n + 1) / 2).

    Args:
        prior, posterior: beliefs (..., n), (..., n, n) before and after the own readings.
    """
    return pack(novelty(prior, posterior))


def incremental(prior: Gaussian, numbers: np.ndarray) -> Gaussian:
    """The incremental update: `novelty.absorb` of what the neighbourhood said.

    Args:
        prior: the node's own, mean (..., n), cov (..., n, n).
        numbers: (..., J, n + n (n + 1) / 2 or more), the node's own first; NaN: not heard.
    """
    return absorb(prior, unpack(numbers[..., : packed_length(prior.mean.shape[-1])]))


def combine(means: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The diffusion update: a convex combination of the estimates of a neighbourhood.

    The covariance stays that of the incremental update.

    Promises: little to send, cheap, unbiased estimates, and on stable plants and those that every
    neighbourhood observes a bounded error.

    Fails: the covariance is not that of the combination and need not bound it. A node that sees
    well mixes in the estimates of those that do not, and keeps the covariance of its own; a node
    whose neighbourhood sees nothing averages at full weight. Not consistent. Needs two rounds: with
    one there is only the incremental update.

    Args:
        means, weights: as numbers and weights of `packed.average`.

    Returns:
        (..., n).

    Raises:
        ValueError: a weight is negative, or they do not sum to 1.
    """
    return average(means, weights)
