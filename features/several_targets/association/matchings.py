"""Sums over all matchings of a bipartite graph, by a recursion over subsets of one side."""

from functools import lru_cache

import numpy as np


def matching_marginals(
    weights: np.ndarray, row_miss: np.ndarray, column_miss: np.ndarray
) -> np.ndarray:
    """Probability (n, m) that a row is matched with a column.

    A matching has as weight the product of the `weights` (n, m) of its pairs, of `row_miss` (n,) of
    the rows and `column_miss` (m,) of the columns that it leaves out. Rows are taken one after the
    other, and only the set of columns that are taken matters to the rows that follow. So n m 2^m
    products replace the sum over all matchings, of which there are more than m!.

    Returns:
        The marginals; NaN where the sum of all weights is 0 or beyond a float.
    """
    rows, columns = weights.shape
    without, beside = _subsets(columns)
    # One entry more than subsets holds the 0 of a set that cannot be.
    forward = np.zeros((rows + 1, 2**columns + 1))
    forward[0, 0] = 1.0
    for row in range(rows):
        before = forward[row]
        forward[row + 1, :-1] = row_miss[row] * before[:-1] + weights[row] @ before[without]
    backward = np.zeros(2**columns + 1)
    backward[:-1] = _left_out(column_miss)
    marginals = np.empty_like(weights)
    for row in reversed(range(rows)):
        taken = backward[beside]
        marginals[row] = weights[row] * (taken @ forward[row, :-1])
        backward[:-1] = row_miss[row] * backward[:-1] + weights[row] @ taken
    with np.errstate(invalid="ignore", divide="ignore"):
        return marginals / backward[0]


@lru_cache(maxsize=32)
def _subsets(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (size, 2^size) of each subset without, and with, each element; 2^size where the
    subset does not have the element, or has it already."""
    subsets, element = np.arange(2**size), 1 << np.arange(size)[:, None]
    has = (subsets & element) != 0
    none = 2**size
    return np.where(has, subsets ^ element, none), np.where(has, none, subsets | element)


def _left_out(column_miss: np.ndarray) -> np.ndarray:
    """Product (2^m,) of `column_miss` (m,) over the columns that each subset lacks."""
    product = np.ones(1)
    for miss in column_miss:
        product = np.concatenate((product * miss, product))
    return product
