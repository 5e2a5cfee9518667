"""Which way of computing suits a batch: by its size, four files that do the same thing.

They agree to rounding (`tests/filters/test_paths.py`). A batch of the same size always takes the
same way, so that drivers with equal batches give equal bits.
"""

from typing import Protocol

import numpy as np

from filters import ukf_columns, ukf_compiled, ukf_lane, ukf_stack
from filters.columns import MANY_LANES
from filters.compiled import serves
from filters.gaussian import Gaussian
from filters.moments import Model, Residual
from filters.sigma_points import SigmaPointRule


class Path(Protocol):
    """The unscented transform and the correction, for batches of some size."""

    def predict(
        self,
        belief: Gaussian,
        transition: Model,
        noise_cov: np.ndarray,
        rule: SigmaPointRule,
        residual: Residual,
        /,
    ) -> Gaussian: ...

    def expect(
        self,
        belief: Gaussian,
        measure: Model,
        m: int,
        noise_cov: np.ndarray,
        rule: SigmaPointRule,
        residual: Residual,
        state_residual: Residual,
        /,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...

    def correct(
        self,
        belief: Gaussian,
        innovation: np.ndarray,
        innovation_cov: np.ndarray,
        cross_cov: np.ndarray,
        /,
    ) -> tuple[Gaussian, np.ndarray]: ...


def path_of_transform(belief: Gaussian, noise_cov: np.ndarray, rule: SigmaPointRule) -> Path:
    """Where `predict` and `expect` of a batch are computed."""
    mean, cov = belief
    n, lanes = mean.shape[-1], mean.shape[:-1]
    # What is to be broadcast over the lanes goes where numpy does it.
    alike = cov.shape == (*lanes, n, n) and noise_cov.shape[:-2] in ((), lanes)
    if not alike or (mean.size > n and rule.reach is None):
        return ukf_stack
    if rule.reach is not None and serves(n, noise_cov.shape[-1]):
        return ukf_compiled
    return _path(mean.size // n)


def path_of_correction(belief: Gaussian, innovation: np.ndarray) -> Path:
    """Where `correct` of a batch is computed."""
    mean, cov = belief
    n, lanes = mean.shape[-1], mean.shape[:-1]
    if cov.shape != (*lanes, n, n) or innovation.shape[:-1] != lanes:
        return ukf_stack
    if serves(n, innovation.shape[-1]):
        return ukf_compiled
    return _path(mean.size // n)


def _path(lanes: int) -> Path:
    if lanes == 1:
        return ukf_lane
    return ukf_columns if lanes >= MANY_LANES else ukf_stack
