"""The optional compiled kernels, if they are installed and wanted.

`KERNELS` is the module `concord_fast` or None. The environment variable CONCORD_KERNELS decides:
`numpy` leaves the kernels aside, `compiled` demands them, and without it they are taken where they
are installed. Results agree to rounding, not to the last bit: all processes of a network must take
the same.
"""

import importlib
import os
from types import ModuleType
from typing import Any

import numpy as np

VARIABLE = "CONCORD_KERNELS"


def choose(wish: str) -> ModuleType | None:
    """The kernels for a wish: `numpy`, `compiled`, or nothing, which takes what is there.

    Raises:
        ValueError: another wish, or kernels are demanded that are not installed.
    """
    if wish not in ("", "numpy", "compiled"):
        raise ValueError(f"{VARIABLE} is {wish!r}, but must be numpy or compiled, or not be set")
    if wish == "numpy":
        return None
    try:
        return importlib.import_module("concord_fast")
    except ImportError as error:
        if wish == "compiled":
            raise ValueError(
                f"{VARIABLE} is compiled, but the kernels are not installed ({error}): build them "
                "with `make fast`, or unset the variable"
            ) from None
        return None


KERNELS: Any = choose(os.environ.get(VARIABLE, ""))


def serves(states: int, readings: int = 1) -> bool:
    """Whether there are kernels, and for this size."""
    return KERNELS is not None and 0 < states <= KERNELS.STATES and 0 < readings <= KERNELS.READINGS


def cholesky(matrix: np.ndarray) -> np.ndarray:
    """As `linalg.cholesky`, for matrices (..., n, n) of a size that is served."""
    return _on_matrices("cholesky", matrix)


def inverse_spd(matrix: np.ndarray) -> np.ndarray:
    """As `linalg.inverse_spd`, for matrices (..., n, n) of a size that is served."""
    return _on_matrices("inverse_spd", matrix)


def _on_matrices(kernel: str, matrix: np.ndarray) -> np.ndarray:
    lanes, n = matrix.shape[:-2], matrix.shape[-1]
    result = np.empty((n, n, *lanes))
    getattr(KERNELS, kernel)(np.asarray(matrix, dtype=float), result)
    return lanes_first(result, 2)


def lanes_first(columns: np.ndarray, own: int) -> np.ndarray:
    """Columns (a, b, *lanes) seen as (*lanes, a, b)."""
    return columns.transpose(*range(own, columns.ndim), *range(own))
