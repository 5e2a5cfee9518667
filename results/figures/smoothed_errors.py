"""Errors of smoothed states beside those of a smoother that hears every sensor."""

from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.metrics import rmse
from concord.results.records.extras import Past
from concord.scenarios.baselines import centralised_past
from concord.scenarios.catalogue import beside_truth, definition_of
from concord.scenarios.setup import Setup


class SmoothedErrors(NamedTuple):
    """Root mean square errors (R, L) of the states of 0, 1, ... steps ago, over the scored ones.

    Of all nodes, and of one smoother of equal lag that hears every sensor.
    """

    network: np.ndarray
    centralised: np.ndarray


def smoothed_errors(
    setup: Setup,
    past: Past,
    central: Gaussian,
    truth: np.ndarray,
    control: np.ndarray | None,
    counted: np.ndarray,
) -> SmoothedErrors:
    """Return the errors of R runs.

    Args:
        setup: of any of the runs.
        past: the nodes' smoothed states (R, S, L, N, n).
        central: filter that hears everything, mean (R, S, n), cov (R, S, n, n).
        truth: (R, S, n). control: (R, S, p), or None.
        counted: (R, S), the scored steps.
    """
    states = list(definition_of(setup.scenario).score.states)
    of_one = centralised_past(setup, central, control, past.mean.shape[2] - 1)
    # Entry (k, l) is about step k - l, whose truth and score it has.
    known = lagged(np.where(counted[..., None], truth, np.nan), past.mean.shape[2])
    of_nodes, of_one = (
        beside_truth(setup.scenario, mean, where) - where
        for mean, where in (
            (past.mean, known[:, :, :, None]),
            (np.moveaxis(of_one.mean, 0, 2), known),
        )
    )
    return SmoothedErrors(rmse(of_nodes[..., states], (1, 3)), rmse(of_one[..., states], (1,)))


def lagged(values: np.ndarray, lags: int) -> np.ndarray:
    """Values (R, S, ...) of 0, 1, ... steps before each step: (R, S, lags, ...), NaN before all."""
    found = np.full((*values.shape[:2], lags, *values.shape[2:]), np.nan)
    for lag in range(min(lags, values.shape[1])):
        found[:, lag:, lag] = values[:, : values.shape[1] - lag]
    return found


def shown_lags(lags: int) -> list[int]:
    """Which of the lags 0, 1, ... to print: powers of two, and the longest."""
    return sorted({0, *(2**k for k in range(lags.bit_length()) if 2**k < lags), lags - 1})
