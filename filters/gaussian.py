"""A belief in its three forms: moments, square root, information; and the way between them."""

from typing import NamedTuple

import numpy as np

from filters.linalg import cholesky, inverse_spd, multiply


class Gaussian(NamedTuple):
    """A normal distribution per lane: mean (..., n), cov (..., n, n) symmetric."""

    mean: np.ndarray
    cov: np.ndarray


class SquareRootGaussian(NamedTuple):
    """The same with cov = factor @ factor.T, factor (..., n, n) lower triangular.

    It is positive semi-definite however it is rounded, and resolves a condition number squared.
    """

    mean: np.ndarray
    factor: np.ndarray


class Information(NamedTuple):
    """The same in canonical form: vector = cov^-1 mean (..., n), matrix = cov^-1 (..., n, n).

    Unlike a Gaussian it can say "nothing is known of this direction": matrix may be singular.
    """

    vector: np.ndarray
    matrix: np.ndarray


def joined(own: Gaussian, held: Gaussian, *others: Gaussian) -> Gaussian:
    """A belief (n,), those that are held (J, n), and others (n,), as one (K, n)."""
    means = [own.mean[None], held.mean, *[other.mean[None] for other in others]]
    covs = [own.cov[None], held.cov, *[other.cov[None] for other in others]]
    return Gaussian(np.concatenate(means), np.concatenate(covs))


def to_information(belief: Gaussian) -> Information:
    """Information form; a lane whose covariance is not positive definite is NaN."""
    matrix = inverse_spd(belief.cov)
    return Information(multiply(matrix, belief.mean), matrix)


def to_gaussian(information: Information) -> Gaussian:
    """Moment form; a lane whose information matrix is not positive definite is NaN."""
    cov = inverse_spd(information.matrix)
    return Gaussian(multiply(cov, information.vector), cov)


def to_square_root(belief: Gaussian) -> SquareRootGaussian:
    """Square-root form; the factor of a lane whose covariance is not positive definite is NaN."""
    return SquareRootGaussian(belief.mean, cholesky(belief.cov))


def from_square_root(belief: SquareRootGaussian) -> Gaussian:
    """Moment form of a square-root belief."""
    return Gaussian(belief.mean, belief.factor @ belief.factor.mT)
