"""Symmetric positive definite matrices in batches: a lane that fails is NaN, and fails alone."""

import functools
import math
from collections.abc import Sequence

import numpy as np

from concord.filters import columns
from concord.filters.columns import in_columns, in_rows


def symmetrise(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part of matrix (..., n, n)."""
    return 0.5 * (matrix + matrix.mT)


def cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower triangular factors (..., n, n) of a batch.

    Reads the lower triangle only. A lane that is not positive definite, or not a number, comes back
    as NaN throughout; it neither raises nor touches the other lanes.

    Raises:
        numpy.linalg.LinAlgError: the last two axes are not square.
    """
    if columns.serves(matrix):
        return in_rows(columns.cholesky(in_columns(matrix, 2)), matrix.shape[:-2])
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        if matrix.ndim < 2 or matrix.shape[-1] != matrix.shape[-2]:
            raise
        # LAPACK gives up a batch for one lane.
        return in_rows(columns.cholesky(in_columns(matrix, 2)), matrix.shape[:-2])
    return lose_failed(factor)


def lose_failed(factor: np.ndarray) -> np.ndarray:
    """Lower triangular factors (..., n, n), all NaN in the lanes where elimination met a NaN.

    Elimination carries a NaN of any column into every later one, so the last pivot tells.
    """
    pivots = factor[..., -1, -1]
    if not math.isnan(np.vdot(pivots, pivots)):
        return factor
    return np.where(np.isnan(pivots)[..., None, None], np.nan, factor)


def inverse_of_triangle(factor: np.ndarray) -> np.ndarray:
    """Inverse (..., n, n) of lower triangular factors (..., n, n)."""
    if columns.serves(factor):
        return in_rows(columns.inverse_of_triangle(in_columns(factor, 2)), factor.shape[:-2])
    return np.linalg.inv(factor)


def inverse_spd(matrix: np.ndarray) -> np.ndarray:
    """Inverse (..., n, n) of symmetric positive definite matrices; NaN in a lane that is not."""
    return factor_and_inverse(matrix)[1]


def factor_and_inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the results of `cholesky` and `inverse_spd` for little more than the second costs."""
    factor = cholesky(matrix)
    whitener = inverse_of_triangle(factor)
    return factor, squared(whitener)


def squared(triangle: np.ndarray) -> np.ndarray:
    """Products W' W (..., n, n) of lower triangular matrices W (..., n, n)."""
    if columns.serves(triangle):
        return in_rows(columns.squared(in_columns(triangle, 2)), triangle.shape[:-2])
    return np.einsum("...ki,...kj->...ij", triangle, triangle)


def solve_spd(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution (..., n, k) of matrix (..., n, n) @ x = right (..., n, k); NaN as inverse_spd."""
    whitener = inverse_of_triangle(cholesky(matrix))
    return whitener.mT @ (whitener @ right)


def multiply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrix (..., m, n) times vector (..., n), lane by lane: (..., m)."""
    return np.einsum("...ij,...j->...i", matrix, vector)


def squared_lengths(vectors: np.ndarray) -> np.ndarray:
    """Sums of squares (...) of vectors (..., n)."""
    return np.vecdot(vectors, vectors)


def times_transposed(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Products L R' (..., n, m) of L (..., n, k) and R (..., m, k), in their order in memory."""
    return np.einsum("...ik,...jk->...ij", left, right)


def lanes_last(array: np.ndarray, own: int) -> np.ndarray:
    """The same array with its lanes contiguous in memory; `own` trailing axes are not lanes."""
    if array.ndim == own:
        return array
    return in_rows(in_columns(array, own), array.shape[: array.ndim - own])


def pack_upper(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle, row by row, of symmetric matrices: (..., n, n) -> (..., n (n + 1) / 2)."""
    n = matrix.shape[-1]
    return matrix.reshape(*matrix.shape[:-2], n * n).take(_places_of_packed(n), axis=-1)


def unpack_upper(packed: np.ndarray) -> np.ndarray:
    """Symmetric matrices (..., n, n) of their packed upper triangles; the inverse of pack_upper.

    Raises:
        ValueError: the last axis is not n (n + 1) / 2 long for any n.
    """
    length = packed.shape[-1]
    n = (math.isqrt(8 * length + 1) - 1) // 2
    if n * (n + 1) // 2 != length:
        raise ValueError(
            f"packed triangle has length {length}, which is not n (n + 1) / 2 for any n: "
            "pass what pack_upper returned, its last axis uncut"
        )
    return packed.take(_places_of_square(n), axis=-1)


@functools.cache
def above_diagonal(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the numbers above the diagonal of (n, n), row by row."""
    return np.triu_indices(n, 1)


@functools.cache
def _upper_triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.triu_indices(n)


@functools.cache
def _places_of_packed(n: int) -> np.ndarray:
    """Where the numbers of a packed triangle are in the matrix, read row by row."""
    rows, columns = _upper_triangle(n)
    return rows * n + columns


@functools.cache
def _places_of_square(n: int) -> np.ndarray:
    """Where the numbers (n, n) of a symmetric matrix are in its packed triangle."""
    places = np.empty((n, n), dtype=np.intp)
    rows, columns = _upper_triangle(n)
    places[rows, columns] = places[columns, rows] = np.arange(len(rows))
    return places


def join_columns(*matrices: np.ndarray) -> np.ndarray:
    """Matrices (..., n, k_i) side by side: (..., n, sum k_i)."""
    return np.concatenate(_alike(matrices, 2), axis=-1)


def join_rows(*matrices: np.ndarray) -> np.ndarray:
    """Matrices (..., k_i, n) one above the other: (..., sum k_i, n)."""
    return np.concatenate(_alike(matrices, 2), axis=-2)


def join_entries(*vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., k_i) one after the other: (..., sum k_i)."""
    return np.concatenate(_alike(vectors, 1), axis=-1)


def join_stacks(*stacks: np.ndarray) -> np.ndarray:
    """Stacks of matrices (..., k_i, n, n) one after the other: (..., sum k_i, n, n)."""
    return np.concatenate(_alike(stacks, 3), axis=-3)


def _alike(parts: tuple[np.ndarray, ...], own: int) -> Sequence[np.ndarray]:
    """With equal leading axes; the last `own` axes are a part's own."""
    shapes = {part.shape[:-own] for part in parts}
    if len(shapes) == 1:
        return parts
    lanes = np.broadcast_shapes(*shapes)
    return [np.broadcast_to(part, (*lanes, *part.shape[-own:])) for part in parts]
