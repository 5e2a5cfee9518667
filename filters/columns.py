"""Small matrices in structure-of-arrays form: lanes last, so that every operation runs along them.

A vector is (n, L), a matrix (n, n, L), for L lanes. `in_columns` converts an array of the project's
order, (..., n) or (..., n, n), to this form; `in_rows` converts it back. Both return views where
the memory already has the order. The results of this file have that order.

A lane that fails is NaN, and fails alone. Reasons and measurements: docs/performance.md.
"""

import numpy as np

# From so many lanes on, passes along them cost less than products of small matrices.
MANY_LANES = 60
_MOST_ROWS = 16


def serves(matrix: np.ndarray) -> bool:
    """Whether a batch (..., n, n) is of many small matrices; larger ones are LAPACK's."""
    if matrix.ndim < 2 or matrix.shape[-1] != matrix.shape[-2]:
        return False
    n = matrix.shape[-1]
    return 0 < n <= _MOST_ROWS and matrix.size >= MANY_LANES * n * n


def in_columns(array: np.ndarray, own: int) -> np.ndarray:
    """Array (..., a, b) as contiguous (a, b, L); `own` trailing axes are not lanes."""
    lanes = array.ndim - own
    moved = array.transpose(*range(lanes, array.ndim), *range(lanes))
    return np.ascontiguousarray(moved.reshape(*array.shape[lanes:], -1))


def in_rows(columns: np.ndarray, lanes: tuple[int, ...]) -> np.ndarray:
    """Columns (a, b, L) seen as (*lanes, a, b)."""
    own = columns.ndim - 1
    shaped = columns.reshape(*columns.shape[:-1], *lanes)
    return shaped.transpose(*range(own, shaped.ndim), *range(own))


def cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular factors (n, n, L) of symmetric matrices; reads the lower triangle only.

    All NaN in a lane that is not positive definite.
    """
    factor = matrix.copy()
    n = len(factor)
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(n):
            column = factor[j:, j]
            if j:
                column -= np.einsum("kl,rkl->rl", factor[j, :j], factor[j:, :j])
            pivot = column[0]
            np.sqrt(pivot, out=pivot)
            column[1:] *= 1.0 / pivot
            factor[j, j + 1 :] = 0.0
    # The root of a negative pivot is NaN, and a pivot of zero makes the next ones NaN.
    failed = ~(factor[-1, -1] > 0)
    if failed.any():
        factor[..., failed] = np.nan
    return factor


def inverse_of_triangle(factor: np.ndarray) -> np.ndarray:
    """Inverses (n, n, L) of lower triangular factors."""
    inverse = np.zeros(factor.shape)
    for i in range(len(factor)):
        pivot = 1.0 / factor[i, i]
        inverse[i, i] = pivot
        if i:
            below = np.einsum("kl,kjl->jl", factor[i, :i], inverse[:i, :i])
            np.multiply(below, -pivot, out=inverse[i, :i])
    return inverse


def squared(triangle: np.ndarray) -> np.ndarray:
    """Products W' W (n, n, L) of lower triangular matrices W."""
    product = np.empty(triangle.shape)
    for i in range(len(triangle)):
        # Row i of W' W has column i of W as its factor, which begins at row i.
        np.einsum("kl,kjl->jl", triangle[i:, i], triangle[i:, : i + 1], out=product[i, : i + 1])
        product[:i, i] = product[i, :i]
    return product
