"""Information-weighted consensus ("ICF"): one pair, the prior weighed by 1 / N.

Source: Kamal, Farrell and Roy-Chowdhury (2013), Information weighted consensus filters and their
application in distributed camera networks, IEEE Trans. Automatic Control 58(12), algorithm 1.
"""

import numpy as np

from concord.filters.fusion.novelty import novelty
from concord.filters.fusion.packed import pack, unpack
from concord.filters.gaussian import Gaussian, Information, to_gaussian, to_information
from concord.filters.linalg import cholesky


def begin(prior: Gaussian, posterior: Gaussian, nodes: int) -> np.ndarray:
    """Return the numbers that a node averages: Omega^- / N + dOmega, packed.

    Args:
        prior, posterior: beliefs (..., n), (..., n, n) before and after the own readings.
        nodes: number N of nodes in the network, which every node must know.

    Returns:
        (..., n + n (n + 1) / 2); NaN in a lane that is not positive definite.
    """
    return pack(to_information(prior)) / nodes + pack(novelty(prior, posterior))


def from_information(numbers: np.ndarray, nodes: int) -> Gaussian:
    """The belief that averages (..., n + n (n + 1) / 2) come to: N times the average.

    Promises: the centralised filter on linear plants where the rounds reach the exact average
    (complete graph, one round). Algebraically it is `hybrid_consensus` with the gain N, in less
    than half of the bytes.

    Fails: overconfident with finitely many rounds, as some novelty enters with N a_ij > 1, and more
    so where shares are lost or not published. It takes some ln(.01) / ln(SLEM) rounds with
    all nodes publishing before that is below a per cent; SLEM is the second largest eigenvalue
    modulus of the weights. Needs doubly stochastic weights.

    Returns:
        mean (..., n), cov (..., n, n); NaN in a lane that is not positive definite.
    """
    vector, matrix = unpack(numbers)
    return to_gaussian(Information(nodes * vector, nodes * matrix))


def sound(numbers: np.ndarray) -> np.ndarray:
    """Whether numbers (..., m) are of a node in its senses: its information is positive definite.

    Returns:
        (...) bool.
    """
    return np.isfinite(cholesky(unpack(numbers).matrix)[..., -1, -1])
