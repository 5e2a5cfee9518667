"""Hybrid consensus on measurements and on information ("HCMCI"): prior and novelty apart.

The nodes average their prior information and what their readings added to it, each by itself, and
at the end of the step add them up: Omega = Omega^- + g dOmega. Averaging counts a prior, which
neighbours have in common, once; the gain g undoes the averaging of novelties, which are new.

Beside the pairs travels row a_i of the product of the weight matrices that were really used (lost
and silent shares included): a_ij says how much of node j's start is in node i's average.

Source: Battistelli, Chisci, Mugnai, Farina and Graziano (2015), Consensus-based linear and
nonlinear filtering, IEEE Trans. Automatic Control 60(5). The safe gain is this project's.
"""

import numpy as np

from concord.filters.fusion.novelty import novelty
from concord.filters.fusion.packed import pack, packed_length, unpack
from concord.filters.gaussian import Gaussian, Information, to_gaussian, to_information
from concord.filters.linalg import cholesky

# A row that came through float32 sums to 1 within this.
_ROW_TOLERANCE = 1e-3


def begin(prior: Gaussian, posterior: Gaussian, row: np.ndarray) -> np.ndarray:
    """Return the numbers that a node averages: prior information, novelty, row; packed in order.

    Args:
        prior, posterior: beliefs (..., n), (..., n, n) before and after the own readings.
        row: (N,) or (..., N), 1 at the node itself and 0 elsewhere.

    Returns:
        (..., 2 (n + n (n + 1) / 2) + N); NaN in a lane that is not positive definite.
    """
    row = np.broadcast_to(row, (*prior.mean.shape[:-1], row.shape[-1]))
    pairs = pack(to_information(prior)), pack(novelty(prior, posterior))
    return np.concatenate((*pairs, row), axis=-1)


def from_information(numbers: np.ndarray, states: int) -> Gaussian:
    """The belief that averages (..., 2 (n + n (n + 1) / 2) + N) come to: Omega^- + g dOmega.

    The gain g_i = 1 / max_j a_ij is the largest with g_i a_ij <= 1 for all j. The rule promises
    consistency. If every prior bounds its node's error covariance, the result bounds the fused one,
    whatever the correlation of the priors. The average of the priors is a covariance intersection,
    and every novelty enters with a factor g_i a_ij <= 1, as if its noise were larger than it is.
    The rule equals the local filter when the node heard no neighbour (a_i a unit row, g = 1). It
    tends to the centralised filter as the rounds tend to infinity (a_ij -> 1/N, g -> N).

    The rule fails where a share is held over into the next step: it would bring its novelty again.

    Returns:
        mean (..., n), cov (..., n, n); NaN in a lane that is not positive definite.
    """
    prior, added, row = _split(numbers, states)
    g = 1.0 / row.max(axis=-1)
    return to_gaussian(
        Information(
            prior.vector + g[..., None] * added.vector,
            prior.matrix + g[..., None, None] * added.matrix,
        )
    )


def sound(numbers: np.ndarray, states: int) -> np.ndarray:
    """Whether numbers (..., m) are of a node in its senses: (...) bool.

    Its prior information is positive definite, also with N times its novelty added; so is then what
    averages of sound ones come to. Its row is of weights.
    """
    prior, added, row = _split(numbers, states)
    most = prior.matrix + row.shape[-1] * added.matrix
    definite = _positive_definite(prior.matrix) & _positive_definite(most)
    weights = (row >= 0).all(axis=-1) & (np.abs(row.sum(axis=-1) - 1) < _ROW_TOLERANCE)
    return np.logical_and(definite, weights)


def _positive_definite(matrix: np.ndarray) -> np.ndarray:
    return np.isfinite(cholesky(matrix)[..., -1, -1])


def _split(numbers: np.ndarray, states: int) -> tuple[Information, Information, np.ndarray]:
    length = packed_length(states)
    prior, added = numbers[..., :length], numbers[..., length : 2 * length]
    return unpack(prior), unpack(added), numbers[..., 2 * length :]
