"""How good estimates are: error, consistency, agreement. Leading axes are free."""

import numpy as np
from numpy.typing import NDArray

from filters.linalg import solve_spd

Array = NDArray[np.float64]


def rmse(errors: Array, axes: tuple[int, ...]) -> Array:
    """Root mean square length of error vectors (..., m) over `axes`; unknown truth left out.

    A vector with a NaN entry says nothing; where no vector is left the result is NaN.
    """
    squared = (errors**2).sum(-1)
    known = ~np.isnan(squared)
    count = known.sum(axes)
    total = np.where(known, squared, 0.0).sum(axes)
    return np.sqrt(np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0))


def nees(errors: Array, cov: Array) -> Array:
    """Normalised estimation error squared e' P^-1 e of errors (..., m) with cov (..., m, m).

    Source: Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and
    Navigation, section 5.4. Its mean is m for a consistent estimate; NaN where the truth is.
    """
    known = np.logical_not(np.isnan(errors).any(axis=-1))
    filled = np.where(known[..., None], errors, 0.0)
    values = (filled * solve_spd(cov, filled[..., None])[..., 0]).sum(-1)
    return np.where(known, values, np.nan)


def anees(errors: Array, cov: Array, axes: tuple[int, ...]) -> Array:
    """Average NEES over `axes` divided by the dimension: 1 is consistent, above overconfident."""
    values = nees(errors, cov) / errors.shape[-1]
    known = ~np.isnan(values)
    count = known.sum(axes)
    total = np.where(known, values, 0.0).sum(axes)
    return np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)


def consensus(mean: Array) -> Array:
    """The average (steps, 1, m) of the estimates (steps, N, m) of the nodes that have one."""
    known = ~np.isnan(mean)
    count = known.sum(axis=1, keepdims=True)
    total = np.where(known, mean, 0.0).sum(axis=1, keepdims=True)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def disagreement(mean: Array) -> float:
    """Root mean square distance of the nodes' estimates (steps, N, m) from their average."""
    return float(rmse(mean - consensus(mean), (0, 1)))
