"""The tracks of a run as variables of run.nc: one trajectory for each identity at each tracker.

Source of the form: CF Conventions 1.11, section H.4.3, contiguous ragged array of trajectories.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from concord.experiments.tracking.track_log import TrackLog
from concord.experiments.tracking.tracks_trace import TracksTrace, log_alone
from concord.filters.tracking.tracks import IDENTITY
from concord.scenarios.setup import Setup

TRUTH, CENTRE = -2, -1
"""Numbers of the trajectories that no node has."""
_NAMES = ("x", "vx", "y", "vy")
_UNITS = ("m", "m s-1", "m", "m s-1")
_AT = {"coordinates": "track_time track_x track_y"}
_KEYS = 1 + IDENTITY
"""Columns of a row that tell its trajectory: tracker and identity; its step follows."""


def track_variables(
    setup: Setup, tracks: TracksTrace, readings: np.ndarray
) -> dict[str, tuple[Any, ...]]:
    """Return the variables of the targets' states, and of the tracks of the centre and the nodes.

    readings (steps, N, 1 + D, 2).
    """
    logs: Mapping[int, TrackLog] = {
        CENTRE: log_alone(setup, range(setup.scenario.nodes), readings, tracks.paths),
        **dict(enumerate(tracks.logs)),
    }
    rows = np.concatenate(
        [_true_rows(tracks.paths), *(_rows(number, log) for number, log in logs.items())]
    )
    rows = rows[np.lexsort(rows[:, _KEYS::-1].T)]
    keys = rows[:, :_KEYS].astype(int)
    starts = np.flatnonzero(np.diff(keys, axis=0, prepend=TRUTH - 1).any(axis=1))
    sizes = np.diff(starts, append=len(rows))
    numbers = keys[starts]
    names = [f"{tracker}/{'-'.join(map(str, key))}" for tracker, *key in numbers.tolist()]
    time = {
        "standard_name": "time",
        "units": "seconds since 2000-01-01 00:00:00",
        "comment": "the run begins at this nominal date",
    }
    columns = ("existence", *_NAMES, *(f"{name}_std" for name in _NAMES))
    units = ("1", *_UNITS, *_UNITS)
    observed = {
        f"track_{name}": ("obs", value, {"units": unit} | ({} if name in "xy" else _AT))
        for name, value, unit in zip(columns, rows[:, _KEYS + 1 :].T, units, strict=True)
    }
    trackers = f"number of the node; {TRUTH} is the truth, {CENTRE} the centre"
    identities = (
        "step, node and place in the scan of the first detection; number of the target for the "
        "truth"
    )
    of_rows = {"long_name": "observations of a trajectory", "sample_dimension": "obs"}
    return {
        "trajectory": ("trajectory_number", names, {"cf_role": "trajectory_id"}),
        "row_size": ("trajectory_number", sizes, of_rows),
        "tracker": ("trajectory_number", numbers[:, 0], {"long_name": trackers}),
        "identity": (("trajectory_number", "label"), numbers[:, 1:], {"long_name": identities}),
        "track_step": ("obs", rows[:, _KEYS].astype(int), {"units": "1"}),
        "track_time": ("obs", rows[:, _KEYS] * setup.time_step_s, time),
        **observed,
    }


def _true_rows(paths: np.ndarray) -> np.ndarray:
    steps, targets = np.nonzero(np.isfinite(paths).all(axis=-1))
    nothing = np.zeros(len(steps))
    key = (np.full(len(steps), TRUTH), targets, nothing, nothing, steps)
    found = paths[steps, targets]
    return np.column_stack((*key, np.ones(len(steps)), found, np.zeros_like(found)))


def _rows(number: int, log: TrackLog) -> np.ndarray:
    """Rows of tracker, identity, step, existence, state and standard deviations."""
    rows = [np.empty((0, _KEYS + 1 + 1 + 2 * len(_NAMES)))]
    for step, (identity, *rest) in zip(log.steps, log.reports, strict=True):
        count = len(identity)
        rows.append(
            np.column_stack((np.full(count, number), identity, np.full(count, step), *rest))
        )
    return np.concatenate(rows)
