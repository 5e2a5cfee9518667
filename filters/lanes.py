"""Joining arrays whose leading axes, the lanes, differ: they are broadcast against each other."""

from collections.abc import Sequence

import numpy as np


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
