"""How good estimates are: error, consistency, agreement. Leading axes are free."""

import math

import numpy as np
from numpy.typing import NDArray

from filters.columns import eliminate, in_columns

Array = NDArray[np.float64]


def mean_of_known(values: Array, axes: tuple[int, ...]) -> Array:
    """Mean over `axes` of what is not NaN; NaN where nothing is."""
    known = np.logical_not(np.isnan(values))
    count = known.sum(axes)
    total = np.where(known, values, 0.0).sum(axes)
    return np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)


def largest_of_known(values: Array) -> Array:
    """Largest over the last axis of what is not NaN; NaN where nothing is."""
    known = np.logical_not(np.isnan(values))
    largest = np.where(known, values, -np.inf).max(axis=-1, initial=-np.inf)
    return np.where(known.any(axis=-1), largest, np.nan)


def rmse(errors: Array, axes: tuple[int, ...]) -> Array:
    """Root mean square length of error vectors (..., m) over `axes`; unknown truth left out.

    A vector with a NaN entry says nothing; where no vector is left the result is NaN.
    """
    return np.sqrt(mean_of_known((errors**2).sum(-1), axes))


def nees(errors: Array, cov: Array) -> Array:
    """Normalised estimation error squared e' P^-1 e of errors (..., m) with cov (..., m, m).

    Source: Bar-Shalom, Li, Kirubarajan (2001), Estimation with Applications to Tracking and
    Navigation, section 5.4. Its mean is m for a consistent estimate; NaN where the truth is.
    """
    known = np.logical_not(np.isnan(errors).any(axis=-1))
    filled = np.where(known[..., None], errors, 0.0)
    # With P = C C' it is the square of C^-1 e, a row that elimination takes along.
    m, lanes = errors.shape[-1], np.broadcast_shapes(known.shape, cov.shape[:-2])
    rows = np.empty((m + 1, m, math.prod(lanes)))
    rows[:m] = in_columns(np.broadcast_to(cov, (*lanes, m, m)), 2)
    rows[m] = in_columns(np.broadcast_to(filled, (*lanes, m)), 1)
    whitened = eliminate(rows, m)[m]
    values = np.einsum("ml,ml->l", whitened, whitened).reshape(lanes)
    return np.where(known, values, np.nan)


def anees(errors: Array, cov: Array, axes: tuple[int, ...]) -> Array:
    """Average NEES over `axes` divided by the dimension: 1 is consistent, above overconfident."""
    return mean_of_known(nees(errors, cov) / errors.shape[-1], axes)


def consensus(mean: Array) -> Array:
    """The average (steps, 1, m) of the estimates (steps, N, m) of the nodes that have one."""
    return mean_of_known(mean, (1,))[:, None]


def disagreement(mean: Array) -> float:
    """Root mean square distance of the nodes' estimates (steps, N, m) from their average."""
    return float(rmse(mean - consensus(mean), (0, 1)))
