"""References of a Monte Carlo study: the baseline filter of each run, and the error bound.

The references do not depend on the network, so cells of a sweep with the same noise share them.
"""

import hashlib
from typing import NamedTuple

import msgspec
import numpy as np

from concord.filters.gaussian import Gaussian
from concord.results.figures.posterior_bound import Truths, posterior_bound
from concord.results.records.runs import Runs
from concord.scenarios.baselines import centralised_of_runs, filters_step_by_step
from concord.scenarios.catalogue import definition_of
from concord.scenarios.moves import with_scripted_moves

# Frames of pieces of several cells that have the same noise.
_KEPT_BYTES = 64 * 1024**2


class RunFrame(NamedTuple):
    """Centralised mean (R, steps, n) and cov (R, steps, n, n) of R runs; bound (steps, n, n)."""

    mean: np.ndarray
    cov: np.ndarray
    bound: np.ndarray

    def of(self, place: slice) -> "RunFrame":
        """Return that of some of the runs, beside the bound of all."""
        return RunFrame(self.mean[place], self.cov[place], self.bound)


def without_bound(belief: Gaussian) -> RunFrame:
    """Return the frame of runs from the filter that hears everything; no bound is computed."""
    steps, n = belief.mean.shape[1:]
    return RunFrame(belief.mean, belief.cov, np.full((steps, n, n), np.nan))


_frames: dict[bytes, RunFrame] = {}


def frame_of(runs: Runs) -> RunFrame:
    """Return the frame of these runs; computed once per process for equal truths and readings."""
    key = _key(runs) if filters_step_by_step(runs.setup) else None
    if key is not None and key in _frames:
        return _frames[key]
    frame = _frame(runs)
    if key is not None:
        _frames[key] = frame
        while len(_frames) > 1 and sum(map(_size_bytes, _frames.values())) > _KEPT_BYTES:
            _frames.pop(next(iter(_frames)))
    return frame


def _size_bytes(frame: RunFrame) -> int:
    return sum(part.nbytes for part in frame)


def _key(runs: Runs) -> bytes:
    setup, scenario = runs.setup, runs.setup.scenario
    # The key leaves out the network, its rule and its bus; the baseline filter does not use them.
    of_the_readings = (
        scenario.plant, scenario.nodes, scenario.filter, scenario.steps, scenario.seed,
        scenario.changes, setup.prior_cov, int(runs.runs[0]),
    )  # fmt: skip
    digest = hashlib.blake2b(msgspec.json.encode(of_the_readings))
    for array in (runs.truth, runs.readings, runs.control, runs.prior_mean):
        if array is not None:
            digest.update(array.tobytes())
    return digest.digest()


def _frame(runs: Runs) -> RunFrame:
    setup, readings = runs.setup, runs.readings
    assert readings is not None, "keep the readings"
    numbers = runs.runs.tolist()
    alone = centralised_of_runs(setup, numbers, readings, runs.control, runs.prior_mean)
    return RunFrame(alone.mean, alone.cov, bound_of(runs))


def bound_of(runs: Runs) -> np.ndarray:
    """The posterior Cramer-Rao bound (steps, n, n) of these runs, which have kept their readings;
    NaN where it is not defined."""
    setup, definition = runs.setup, definition_of(runs.setup.scenario)
    steps, n = runs.truth.shape[1:]
    # The bound's model does not cover another wiring, a set-valued rule or a gate.
    if definition.is_received or definition.wirings or not filters_step_by_step(setup):
        return np.full((steps, n, n), np.nan)
    assert runs.readings is not None, "keep the readings"
    groups = definition.sensor_groups(with_scripted_moves(setup).scenario)
    truths = Truths(runs.truth, runs.readings, runs.control)
    return posterior_bound(
        truths, np.array(setup.prior_cov), definition.model(setup.scenario), groups
    )
