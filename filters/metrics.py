"""How good estimates are: error, consistency, agreement. Leading axes are free."""

import numpy as np

from concord.filters.linalg import cholesky, inverse_of_triangle, multiply


def mean_of_known(values: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Mean over `axes` of what is not NaN; NaN where nothing is."""
    total = np.asarray(values.sum(axes))
    # Most values are known: then their sum is all that is needed, and a fraction of the work.
    if total.size and total.size < values.size and np.isfinite(total).all():
        return total / (values.size // total.size)
    known = np.logical_not(np.isnan(values))
    count = np.count_nonzero(known, axis=axes)
    total = np.where(known, values, 0.0).sum(axes)
    return np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)


def largest_of_known(values: np.ndarray) -> np.ndarray:
    """Largest over the last axis of what is not NaN; NaN where nothing is."""
    known = np.logical_not(np.isnan(values))
    largest = np.where(known, values, -np.inf).max(axis=-1, initial=-np.inf)
    return np.where(known.any(axis=-1), largest, np.nan)


def rmse(errors: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Root mean square length of error vectors (..., m) over `axes`; unknown truth left out.

    A vector with a NaN entry says nothing; where no vector is left the result is NaN.
    """
    return np.sqrt(mean_of_known((errors**2).sum(-1), axes))


def nees(errors: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Normalised estimation error squared e' P^-1 e of errors (..., m) with cov (..., m, m).

    Source: Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and
    Navigation, section 5.4. Its mean is m for a consistent estimate; NaN where the truth is.
    """
    known = np.logical_not(np.isnan(errors).any(axis=-1))
    filled = np.where(known[..., None], errors, 0.0)
    whitened = multiply(inverse_of_triangle(cholesky(cov)), filled)
    return np.where(known, np.vecdot(whitened, whitened), np.nan)


def consensus(mean: np.ndarray) -> np.ndarray:
    """The average (..., 1, m) of the estimates (..., N, m) of the nodes that have one."""
    return mean_of_known(mean, (-2,))[..., None, :]
