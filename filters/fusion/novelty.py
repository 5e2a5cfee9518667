"""Novelty: the information that a node's own readings add to its belief, usable by other nodes.

For a linear sensor z = H x + v of covariance R it is the pair (H' R^-1 z, H' R^-1 H), whatever the
node believed before. For the unscented filter it is the same with the statistical linearisation
about the node's prior, its error counted as noise.

Source: Battistelli, Chisci, Mugnai, Farina and Graziano (2015), Consensus-based linear and
nonlinear filtering, IEEE Trans. Automatic Control 60(5), where it is called the novel information.
"""

import numpy as np

from concord.filters.gaussian import Gaussian, Information, to_information
from concord.filters.linalg import inverse_spd, multiply


def novelty(prior: Gaussian, posterior: Gaussian) -> Information:
    """Information (..., n) and (..., n, n) of the posterior less that of the prior.

    Exactly zero where the posterior is the prior bit for bit, as after no reading; NaN in a lane
    whose prior or posterior covariance is not positive definite.
    """
    before, after = to_information(prior), to_information(posterior)
    return Information(after.vector - before.vector, after.matrix - before.matrix)


def absorb(prior: Gaussian, novelties: Information) -> Gaussian:
    """The belief that the readings of several nodes make of one prior: information adds up.

    Promises: with linear sensors and independent noises it is the Kalman update by all readings at
    once. So nodes that begin with one prior and all hear each other are the centralised filter
    (`centralised`: complete graph, full schedule, one round). With nonlinear sensors it differs
    from the unscented update by the stacked readings, which redraws its points, to the order in
    which each sensor bends over the spread of the prior.

    Fails: a novelty that is lost leaves the node with another prior than its neighbours from then
    on. A novelty absorbed twice is believed twice: never pass on what came from others.

    Source: the information filter, Anderson and Moore (1979), Optimal filtering, section 6.3.

    Args:
        prior: mean (..., n), cov (..., n, n).
        novelties: vector (..., J, n), matrix (..., J, n, n); an entry that has a NaN was not heard
            and adds nothing.

    Returns:
        The posterior; NaN in a lane where prior or posterior is not positive definite.
    """
    heard = _heard(novelties)
    vectors = np.where(heard[..., None], novelties.vector, 0.0)
    matrices = np.where(heard[..., None, None], novelties.matrix, 0.0)
    matrix = matrices.sum(axis=-3)
    cov = inverse_spd(inverse_spd(prior.cov) + matrix)
    # A correction of the mean, not a mean built anew, spares its digits.
    innovation = vectors.sum(axis=-2) - multiply(matrix, prior.mean)
    return Gaussian(prior.mean + multiply(cov, innovation), cov)


def _heard(novelties: Information) -> np.ndarray:
    """True (..., J) where a novelty has no NaN."""
    missing = np.isnan(novelties.vector).any(axis=-1)
    return np.logical_not(missing | np.isnan(novelties.matrix).any(axis=(-1, -2)))
