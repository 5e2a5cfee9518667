"""The optional compiled kernels, if they are installed and wanted.

`KERNELS` is the module `concord_fast` or None. The environment variable CONCORD_KERNELS decides:
`numpy` leaves the kernels aside, `compiled` demands them, and without it they are taken where they
are installed. Results agree to rounding, not to the last bit: all processes of a network must take
the same.
"""

import functools
import importlib
import os
from types import ModuleType
from typing import Any

import numpy as np

VARIABLE = "CONCORD_KERNELS"
# Of the functions that are called here, as the kernels know them: `fast/concord_fast.cpp`.
INTERFACE = 4


def choose(wish: str) -> ModuleType | None:
    """The kernels for a wish: `numpy`, `compiled`, or nothing, which takes what is there.

    Raises:
        ValueError: another wish, or kernels are demanded that are not installed, or are those of
            another version.
    """
    if wish not in ("", "numpy", "compiled"):
        raise ValueError(f"{VARIABLE} is {wish!r}, but must be numpy or compiled, or not be set")
    if wish == "numpy":
        return None
    try:
        kernels = importlib.import_module("concord_fast")
    except ImportError as error:
        trouble = f"are not installed ({error})"
    else:
        if getattr(kernels, "INTERFACE", None) == INTERFACE:
            return kernels
        trouble = "that are installed were built for another version of concord"
    if wish == "compiled":
        raise ValueError(
            f"{VARIABLE} is compiled, but the kernels {trouble}: build them with `make fast`, or "
            "unset the variable"
        )
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


def informed(mean: np.ndarray, cov: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `packed.informed`, for beliefs (..., n) of a size that is served."""
    lanes, n = mean.shape[:-1], mean.shape[-1]
    numbers, sharpness = np.empty((n * (n + 3) // 2, *lanes)), np.empty(lanes)
    KERNELS.informed(mean, cov, numbers, sharpness)
    return lanes_first(numbers, 1), sharpness


def concluded(numbers: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """As `packed.concluded`, for numbers (..., m) of n states, a size that is served."""
    lanes = numbers.shape[:-1]
    mean, cov = np.empty((n, *lanes)), np.empty((n, n, *lanes))
    KERNELS.concluded(numbers, mean, cov)
    return lanes_first(mean, 1), lanes_first(cov, 2)


def fused(
    own_mean: np.ndarray,
    own_cov: np.ndarray,
    means: np.ndarray,
    covs: np.ndarray,
    weights: np.ndarray,
    by_sharpness: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """As `fusion.Averaging.fuse`, for averages of information of a size that is served: mean (n,)
    and covariance (n, n), the weights that were used and the sharpness (1 + J,)."""
    n, beliefs = own_mean.shape[-1], weights.shape[-1]
    mean, cov, used, sharp = np.empty(n), np.empty((n, n)), np.empty(beliefs), np.empty(beliefs)
    given = (own_mean, own_cov, means, covs, weights, by_sharpness)
    KERNELS.fused(*given, mean, cov, used, sharp)
    return mean, cov, used, sharp


def sharpness(triangle: np.ndarray, n: int) -> np.ndarray:
    """As `packed.sharpness`, for triangles (..., m) of n states, a size that is served."""
    result = np.empty(triangle.shape[:-1])
    KERNELS.sharpness(triangle, n, result)
    return result


def _on_matrices(kernel: str, matrix: np.ndarray) -> np.ndarray:
    lanes, n = matrix.shape[:-2], matrix.shape[-1]
    result = np.empty((n, n, *lanes))
    getattr(KERNELS, kernel)(np.asarray(matrix, dtype=float), result)
    return lanes_first(result, 2)


def lanes_first(columns: np.ndarray, own: int) -> np.ndarray:
    """Columns (a, b, *lanes) seen as (*lanes, a, b)."""
    return columns.transpose(_lanes_then_own(columns.ndim, own))


@functools.cache
def _lanes_then_own(axes: int, own: int) -> tuple[int, ...]:
    return (*range(own, axes), *range(own))
