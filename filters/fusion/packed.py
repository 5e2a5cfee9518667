"""An information pair as one vector of numbers: what travels, and what averages are taken of.

Consensus on information is linear. Once a node's knowledge is a vector (..., m), a round is a row
of the weight matrix times the vectors of those it heard, and L rounds are the L-th power.
"""

import math

import numpy as np

from concord.filters.fusion.hold import (
    check_weights,
    inverse_volume,
    inverse_volume_of_factor,
    renormalise,
)
from concord.filters.gaussian import Gaussian, Information, to_gaussian
from concord.filters.linalg import factor_and_inverse, multiply, pack_upper, unpack_upper


def packed_length(states: int) -> int:
    """Numbers in a packed pair of n states: n + n (n + 1) / 2."""
    return states * (states + 3) // 2


def pack(information: Information) -> np.ndarray:
    """Vector, then the upper triangle of the matrix row by row: (..., n + n (n + 1) / 2)."""
    return np.concatenate((information.vector, pack_upper(information.matrix)), axis=-1)


def unpack(numbers: np.ndarray) -> Information:
    """The pair of which numbers (..., n + n (n + 1) / 2) are the packed form.

    Raises:
        ValueError: the last axis is not n + n (n + 1) / 2 long for any n.
    """
    n = states_of(numbers)
    return Information(numbers[..., :n], unpack_upper(numbers[..., n:]))


def states_of(numbers: np.ndarray) -> int:
    """How many states the packed pairs (..., m) are of.

    Raises:
        ValueError: m is not n + n (n + 1) / 2 for any n.
    """
    length = numbers.shape[-1]
    n = (math.isqrt(8 * length + 9) - 3) // 2
    if packed_length(n) != length:
        raise ValueError(
            f"packed information has length {length}, which is not n + n (n + 1) / 2 for any n: "
            "pass what pack returned, its last axis uncut"
        )
    return n


def to_packed_information(belief: Gaussian) -> tuple[np.ndarray, np.ndarray]:
    """Packed information (..., m) of a belief, and its `hold.inverse_volume` (...), from one
    factorisation; NaN where the covariance is not positive definite."""
    mean, cov = belief
    factor, matrix = factor_and_inverse(cov)
    return pack(Information(multiply(matrix, mean), matrix)), inverse_volume_of_factor(factor)


def from_packed_information(numbers: np.ndarray) -> Gaussian:
    """The belief of packed information (..., m); NaN where that is not positive definite."""
    return to_gaussian(unpack(numbers))


def packed_inverse_volume(numbers: np.ndarray) -> np.ndarray:
    """`hold.inverse_volume` (...) of matrices in packed pairs (..., m), read as covariances."""
    return inverse_volume(unpack(numbers).matrix)


def average(numbers: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted average of what was heard, a round of linear consensus.

    Promises: with doubly stochastic weights (N, N) and nothing lost, the mean over the network
    stays what it was, and disagreement falls per round by the second largest eigenvalue modulus.

    Args:
        numbers: (..., J, m), the node's own first; an entry that has a NaN was not heard, but the
            own, which makes its lane NaN.
        weights: (..., J), not negative, sum 1; renormalised over those heard.

    Returns:
        (..., m).

    Raises:
        ValueError: a weight is negative, or they do not sum to 1.
    """
    check_weights(weights)
    silent = np.isnan(numbers).any(axis=-1) & (np.arange(numbers.shape[-2]) > 0)
    used = renormalise(weights, np.where(silent, -1, 0))
    return multiply(np.where(silent[..., None], 0.0, numbers).mT, used)
