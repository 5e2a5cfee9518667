"""Symmetric positive definite matrices in batches: a lane that fails is NaN, and fails alone."""

import functools
import math

import numpy as np

from filters import columns, compiled
from filters.columns import MANY_LANES, in_columns, in_rows


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
    if _square(matrix) and compiled.serves(matrix.shape[-1]):
        return compiled.cholesky(matrix)
    if _many(matrix):
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
    if not math.isnan(pivots.sum()):
        return factor
    return np.where(np.isnan(pivots)[..., None, None], np.nan, factor)


def inverse_spd(matrix: np.ndarray) -> np.ndarray:
    """Inverse (..., n, n) of symmetric positive definite matrices; NaN in a lane that is not."""
    if _square(matrix) and compiled.serves(matrix.shape[-1]):
        return compiled.inverse_spd(matrix)
    return factor_and_inverse(matrix)[1]


def factor_and_inverse(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What `cholesky` and `inverse_spd` give, for little more than the price of the second; by
    numpy."""
    if _many(matrix):
        factors = columns.cholesky(in_columns(matrix, 2))
        inverses = columns.inverse_of_factor(factors)
        return in_rows(factors, matrix.shape[:-2]), in_rows(inverses, matrix.shape[:-2])
    factor = cholesky(matrix)
    whitener = np.linalg.inv(factor)
    return factor, whitener.mT @ whitener


def solve_spd(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution (..., n, k) of matrix (..., n, n) @ x = right (..., n, k); NaN as inverse_spd."""
    if _many(matrix) and matrix.shape[:-2] == right.shape[:-2]:
        inverse = in_columns(inverse_spd(matrix), 2)
        product = np.einsum("ijl,jkl->ikl", inverse, in_columns(right, 2))
        return in_rows(product, matrix.shape[:-2])
    whitener = np.linalg.inv(cholesky(matrix))
    return whitener.mT @ (whitener @ right)


def multiply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrix (..., m, n) times vector (..., n), lane by lane: (..., m)."""
    if matrix.shape[:-2] == vector.shape[:-1] and along_lanes(matrix, 2):
        product = np.einsum("ijl,jl->il", in_columns(matrix, 2), in_columns(vector, 1))
        return in_rows(product, vector.shape[:-1])
    return (matrix @ vector[..., None])[..., 0]


def pack_upper(matrix: np.ndarray) -> np.ndarray:
    """Upper triangle, row by row, of symmetric matrices: (..., n, n) -> (..., n (n + 1) / 2)."""
    n = matrix.shape[-1]
    if along_lanes(matrix, 2):
        rows, columns = _upper_triangle(n)
        return in_rows(in_columns(matrix, 2)[rows, columns], matrix.shape[:-2])
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
    if along_lanes(packed, 1):
        rows, columns = _upper_triangle(n)
        given = in_columns(packed, 1)
        square = np.empty((n, n, given.shape[-1]), packed.dtype)
        square[rows, columns] = square[columns, rows] = given
        return in_rows(square, packed.shape[:-1])
    return packed.take(_places_of_square(n), axis=-1)


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


def _many(matrix: np.ndarray) -> bool:
    """Whether to go along the lanes: matrices of some size are LAPACK's however many they are."""
    n = matrix.shape[-1]
    return n <= 16 and _square(matrix) and matrix.size >= MANY_LANES * n * n > 0


def along_lanes(array: np.ndarray, own: int) -> bool:
    """Whether an array, of which `own` trailing axes are not lanes, has many lanes that follow each
    other in memory."""
    last = array.ndim - own - 1
    if last < 0 or array.strides[last] != array.itemsize:
        return False
    return math.prod(array.shape[: last + 1]) >= MANY_LANES


def _square(matrix: np.ndarray) -> bool:
    return matrix.ndim > 1 and matrix.shape[-1] == matrix.shape[-2]
