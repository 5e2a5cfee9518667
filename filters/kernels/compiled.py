"""The optional compiled kernel of a node's fusion, if it is installed and wanted.

`KERNELS` is the module `concord_fast` or None. The environment variable CONCORD_KERNELS decides:
`numpy` leaves the kernel aside, `compiled` demands it, and without the variable it is taken where
it is installed. Results agree to rounding, not to the last bit: all processes of a network must
take the same. ARCHITECTURE.md has the measurements.
"""

import importlib
import os
from types import ModuleType
from typing import Any

import numpy as np

VARIABLE = "CONCORD_KERNELS"
# Of the functions that are called here, as the kernels know them: `fast/concord_fast.cpp`.
INTERFACE = 5


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


def serves(states: int) -> bool:
    """Return whether there is a kernel, and for this number of states."""
    return KERNELS is not None and 0 < states <= KERNELS.STATES


def fused(
    own_mean: np.ndarray,
    own_cov: np.ndarray,
    means: np.ndarray,
    covs: np.ndarray,
    weights: np.ndarray,
    by_sharpness: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Average as `fusion.Averaging.fuse` does, for averages of information of a supported size.

    Return mean (n,), covariance (n, n), the weights used and the inverse volumes (1 + J,).
    """
    n, beliefs = own_mean.shape[-1], weights.shape[-1]
    mean, cov, used, sharp = np.empty(n), np.empty((n, n)), np.empty(beliefs), np.empty(beliefs)
    given = (own_mean, own_cov, means, covs, weights, by_sharpness)
    KERNELS.fused(*given, mean, cov, used, sharp)
    return mean, cov, used, sharp
