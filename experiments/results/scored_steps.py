"""The steps of a run on which errors are scored, and the errors of states."""

import numpy as np

from concord.experiments.results.trace import Trace
from concord.scenarios.scenario_definition import Score


def first_scored(score: Score, trace: Trace) -> int:
    """The step from which errors count: the scenario's, but not before the first reading."""
    seen = ~np.isnan(trace.readings).all((1, 2, 3))
    first_seen = int(np.argmax(seen)) if seen.any() else 0
    return min(max(score.first_step, first_seen), trace.steps - 1)


def near_steps(score: Score, trace: Trace, time_step_s: float) -> np.ndarray:
    """Which steps (steps,) are at most `near_s` after a reading by any node."""
    if score.near_s is None:
        return np.ones(trace.steps, dtype=bool)
    seen = ~np.isnan(trace.readings).all((1, 2, 3))
    reach = round(score.near_s / time_step_s)
    return np.convolve(seen, np.ones(reach + 1))[: trace.steps] > 0.5


def state_errors(mean: np.ndarray, truth: np.ndarray, score: Score, first: int) -> np.ndarray:
    """Errors (steps, ..., m) of the scored states of mean (steps, ..., n)."""
    states = list(score.states)
    known = truth[first:][:, states]
    return mean[first:][..., states] - known.reshape(len(known), *(1,) * (mean.ndim - 2), -1)
