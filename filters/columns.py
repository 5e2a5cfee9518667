"""Small matrices in structure-of-arrays form: lanes last, so that every operation runs along them.

A vector is (n, L), a matrix (n, n, L), for L lanes. `in_columns` gives an array of the project's
order, (..., n) or (..., n, n), in this form, and `in_rows` the other way: both are views where the
memory already has the order, and the results of this file have it.

A lane that fails is NaN, and fails alone. Reasons and measurements: docs/performance.md.
"""

import numpy as np

# From so many lanes on, passes along them cost less than products of small matrices.
MANY_LANES = 60


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


def eliminate(rows: np.ndarray, count: int) -> np.ndarray:
    """Cholesky elimination of `count` columns, in place, on rows (r >= count, count, L).

    The first `count` rows hold the lower triangle of a symmetric matrix S = C C' and become C (the
    upper triangle is not touched); a further row b becomes b C^-T. Where S is not positive definite
    the lane is NaN from that column on.
    """
    with np.errstate(invalid="ignore"):
        for j in range(count):
            column = rows[j:, j]
            if j:
                column -= np.einsum("kl,rkl->rl", rows[j, :j], rows[j:, :j])
            pivot = column[0]
            # A pivot of zero fails too, and a root alone would let it pass.
            np.copyto(pivot, np.nan, where=~(pivot > 0))
            np.sqrt(pivot, out=pivot)
            column[1:] /= pivot
    return rows


def cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular factors (n, n, L); all NaN in a lane that is not positive definite."""
    factor = matrix.copy()
    n = len(factor)
    eliminate(factor, n)
    for i in range(n):
        factor[i, i + 1 :] = 0.0
    failed = np.isnan(factor[-1, -1])
    if failed.any():
        factor[..., failed] = np.nan
    return factor


def inverse_spd(matrix: np.ndarray) -> np.ndarray:
    """Inverses (n, n, L) of symmetric positive definite matrices; NaN in a lane that is not."""
    return inverse_of_factor(cholesky(matrix))


def inverse_of_factor(factor: np.ndarray) -> np.ndarray:
    """Inverses (n, n, L) of the matrices of which these are the lower triangular factors."""
    whitener = inverse_triangle(factor)
    inverse = np.empty(factor.shape)
    for i in range(len(factor)):
        # What lies above the diagonal is zero.
        row = inverse[i, : i + 1]
        np.einsum("rl,rjl->jl", whitener[i:, i], whitener[i:, : i + 1], out=row)
    return mirror(inverse)


def inverse_triangle(factor: np.ndarray) -> np.ndarray:
    """Inverses (n, n, L) of lower triangular factors."""
    inverse = np.zeros(factor.shape)
    for i in range(len(factor)):
        pivot = 1.0 / factor[i, i]
        inverse[i, i] = pivot
        if i:
            below = np.einsum("kl,kjl->jl", factor[i, :i], inverse[:i, :i])
            np.multiply(below, -pivot, out=inverse[i, :i])
    return inverse


def packed_pivots(triangles: np.ndarray, n: int) -> np.ndarray:
    """Pivots (n, L) of eliminating symmetric matrices, of which these are the upper triangles row
    by row, (n (n + 1) / 2, L): their product is the determinant. NaN where the matrix is not
    positive definite."""
    starts = [j * n - j * (j - 1) // 2 for j in range(n + 1)]
    rows = [part.copy() for part in np.split(triangles, starts[1:-1])]
    with np.errstate(all="ignore"):
        for j, row in enumerate(rows):
            parts = row[1:] / row[0]
            for k, part in enumerate(parts):
                rows[j + 1 + k] -= part * row[1 + k :]
    pivots = np.array([row[0] for row in rows])
    positive = (pivots > 0).all(axis=0)
    return pivots if positive.all() else np.where(positive, pivots, np.nan)


def mirror(matrix: np.ndarray) -> np.ndarray:
    """The lower triangle written into the upper one, in place."""
    for i in range(1, len(matrix)):
        matrix[:i, i] = matrix[i, :i]
    return matrix
