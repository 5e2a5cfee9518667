"""The Kalman-consensus filter ("KCF"): the neighbours' readings, and a pull to their predictions.

Source: Olfati-Saber (2009), Kalman-consensus filter: optimality, stability, and performance, 48th
IEEE Conf. on Decision and Control, algorithm 1.
"""

import numpy as np

from concord.filters.fusion.novelty import absorb, novelty
from concord.filters.fusion.packed import pack, unpack
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply


def largest_rate(neighbours: int) -> float:
    """The largest rate with which averaging by it is averaging at every node, where no node has
    more neighbours than that."""
    return 1.0 / (1 + neighbours)


def begin(prior: Gaussian, posterior: Gaussian) -> np.ndarray:
    """Return the node's share of the first round: its novelty, packed, and the mean of its prior.

    Args:
        prior, posterior: beliefs (..., n), (..., n, n) before and after the own readings.

    Returns:
        (..., n + n (n + 1) / 2 + n).
    """
    return np.concatenate((pack(novelty(prior, posterior)), prior.mean), axis=-1)


def correct(prior: Gaussian, numbers: np.ndarray, rate: float) -> Gaussian:
    """The first round: x = x^- + M (y - S x^-) + gamma P^- sum_j (x_j^- - x^-), M as absorbed.

    gamma = rate / (|P^-| + 1) with the Frobenius norm, which bounds the pull of a neighbour by
    `rate` however large P^- is. A norm of a covariance mixes the units of the state.

    Promises: stable estimates for a small rate on a plant that the whole network observes, if
    nothing is lost (theorem 2 of the source, for linear plants).

    Fails: the covariance is M, as if the pull had not been. It is not that of the result and need
    not bound it: not consistent. Nodes whose neighbourhood sees nothing follow their neighbours by
    the mean alone, and more slowly the smaller the rate.

    Args:
        prior: the node's own, mean (..., n), cov (..., n, n).
        numbers: (..., J, n + n (n + 1) / 2 + n) as `begin` gives them, the node's own first; NaN:
            not heard.
        rate: epsilon, above 0 and at most 1 / (1 + most neighbours of any node), with which
            `average` is an average on any graph.

    Returns:
        mean (..., n), cov (..., n, n); NaN in a lane that is not positive definite.
    """
    n = prior.mean.shape[-1]
    absorbed = absorb(prior, unpack(numbers[..., :-n]))
    gamma = rate / (np.linalg.norm(prior.cov, axis=(-2, -1)) + 1.0)
    pull = _pull(numbers[..., -n:])
    return Gaussian(absorbed.mean + gamma[..., None] * multiply(prior.cov, pull), absorbed.cov)


def average(means: np.ndarray, rate: float) -> np.ndarray:
    """A later round: x + rate sum_j (x_j - x), which averages the means by maximum-degree weights.

    The covariance stays what it was: averaging means that are not alike makes it wrong further.

    Args:
        means: (..., J, n), the node's own first; NaN: not heard, and no pull.
        rate: as in `correct`.

    Returns:
        (..., n).
    """
    return means[..., 0, :] + rate * _pull(means)


def _pull(means: np.ndarray) -> np.ndarray:
    """Sum (..., n) over the neighbours of means (..., J, n) less the own, which is the first."""
    silent = np.isnan(means).any(axis=-1, keepdims=True)
    return np.where(silent, 0.0, means - means[..., :1, :]).sum(axis=-2)
