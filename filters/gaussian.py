"""A belief in its two forms, moments and information, and the way between them."""

from typing import NamedTuple

import numpy as np

from concord.filters.linalg import inverse_spd, multiply


class Gaussian(NamedTuple):
    """A normal distribution per lane: mean (..., n), cov (..., n, n) symmetric."""

    mean: np.ndarray
    cov: np.ndarray


class Information(NamedTuple):
    """The same in canonical form: vector = cov^-1 mean (..., n), matrix = cov^-1 (..., n, n).

    Unlike a Gaussian it can say "nothing is known of this direction": matrix may be singular.
    """

    vector: np.ndarray
    matrix: np.ndarray


def joined(own: Gaussian, held: Gaussian) -> Gaussian:
    """A belief (..., n) and those that are held (..., J, n) as one (..., 1 + J, n)."""
    return Gaussian(
        np.concatenate((own.mean[..., None, :], held.mean), axis=-2),
        np.concatenate((own.cov[..., None, :, :], held.cov), axis=-3),
    )


def to_information(belief: Gaussian) -> Information:
    """Information form; a lane whose covariance is not positive definite is NaN."""
    matrix = inverse_spd(belief.cov)
    return Information(multiply(matrix, belief.mean), matrix)


def to_gaussian(information: Information) -> Gaussian:
    """Moment form; a lane whose information matrix is not positive definite is NaN."""
    cov = inverse_spd(information.matrix)
    return Gaussian(multiply(cov, information.vector), cov)


def stacked_size(states: int, models: int) -> int:
    """Length of the mean of a stacked belief of several models; of a plain one for a single."""
    return models * (states + 1) - 1


def stacked_blocks(states: int, models: int) -> np.ndarray:
    """Where the covariance (S, S) of a stacked belief is not 0, True."""
    model = np.concatenate((np.repeat(np.arange(models), states), models + np.arange(models - 1)))
    return model[:, None] == model
