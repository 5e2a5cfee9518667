"""Bounds on rounding, entry by entry, that keep the sets certain in floating point.

A state in one unit may be 10^12 times as large as a state in another. Each entry therefore has its
own bound, from the magnitudes that its own sum went through. Rows of different units are compared
by their direction only (`row_units`).
"""

import numpy as np

from concord.filters.linalg import squared_lengths

UNIT_ROUNDOFF = 2.0**-53
# Directions weaker than this, relative to the strongest of rows with length one, are rounding.
RANK_TOLERANCE = 1e-9


def rounding_bound(terms: int) -> float:
    """Relative error of everything that a step computes from sums of `terms` products.

    One such sum is off by at most terms * 2^-53 times the sum of the absolute products (Higham
    (2002), Accuracy and stability of numerical algorithms, section 3.1). The truth is computed with
    rounding too, and a step is a chain of a few such sums: eight times that holds all of them.
    """
    return 8 * terms * UNIT_ROUNDOFF


def magnitudes(state: np.ndarray, noise: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Bound (..., rows) on |state x + noise v| entry by entry, |x| <= reach and each |v_i| <= 1.

    Args:
        state: (..., rows, n). noise: (..., rows, g, q), of g samples. reach: (..., n).
    """
    reached: np.ndarray = (np.abs(state) @ reach[..., None])[..., 0]
    return reached + np.sqrt(squared_lengths(noise)).sum(-1)


def row_units(matrix: np.ndarray) -> np.ndarray:
    """Lengths of the rows (..., k) of a matrix (..., k, d); 1 for a row of zeros."""
    lengths = np.sqrt(squared_lengths(matrix))
    return np.where(lengths == 0.0, 1.0, lengths)


def pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse (..., d, k) by rows in their own units; NaN in lanes that are not numbers."""
    return _inverted(matrix, full=False)[0]


def pseudo_inverse_and_null_space(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`pseudo_inverse`, and columns (..., d, f) that span the null space of matrix (..., k, d).

    Zero columns fill up where the null spaces of lanes differ in size.
    """
    inverse, kept, right = _inverted(matrix, full=True)
    if kept.all():
        return inverse, right[..., kept.shape[-1] :, :].mT
    # Singular values descend: what is known comes first.
    cuts = kept.sum(-1)
    fewest = int(cuts.min(initial=matrix.shape[-2]))
    free = np.arange(fewest, right.shape[-1]) >= cuts[..., None]
    return inverse, right[..., fewest:, :].mT * free[..., None, :]


def _inverted(matrix: np.ndarray, full: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pseudo-inverse, which singular values (..., r) count, and the right singular vectors."""
    units = row_units(matrix)
    sound = np.asarray(np.isfinite(units).all(-1))[..., None, None]
    rows = matrix / units[..., None]
    left, singular, right = np.linalg.svd(
        rows if sound.all() else np.where(sound, rows, 0.0), full_matrices=full
    )
    kept = singular > RANK_TOLERANCE * singular[..., :1]
    inverse = np.divide(1.0, singular, out=np.zeros_like(singular), where=kept)
    seen, count = right[..., : inverse.shape[-1], :], inverse.shape[-1]
    found = (seen.mT * inverse[..., None, :]) @ left[..., :count].mT / units[..., None, :]
    return (found if sound.all() else np.where(sound, found, np.nan)), kept, right
