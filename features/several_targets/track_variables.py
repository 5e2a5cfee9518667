"""The tracks of a run as variables of run.nc: one trajectory for each identity at each tracker.

Source of the form: CF Conventions 1.11, section H.4.3, contiguous ragged array of trajectories.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from concord.features.several_targets.swarm_tracking import swarm_of
from concord.features.several_targets.track_log import TrackLog
from concord.features.several_targets.tracking.scores import CUTOFF_M
from concord.features.several_targets.tracking.tracks import IDENTITY, report_of
from concord.features.several_targets.tracks_trace import TracksTrace, log_alone
from concord.nodes.messages import TRACK_NUMBERS
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray

TRUTH, CENTRE = -2, -1
"""Numbers of the trajectories that no node has."""
_NAMES = ("x", "vx", "y", "vy")
_COLUMNS = ("existence", *_NAMES, *(f"{name}_std" for name in _NAMES))
_UNITS = ("m", "m s-1", "m", "m s-1")
_RUN = "trajectory_run"
_NO_ROWS = np.empty((0, TRACK_NUMBERS))
_AT = {"coordinates": "track_time track_x track_y"}
_KEYS = 1 + IDENTITY
"""Columns of a row that tell its trajectory: tracker and identity; its step follows."""


def track_variables(
    setup: Setup, runs: Sequence[int], tracks: Sequence[TracksTrace], readings: np.ndarray | None
) -> dict[str, tuple[Any, ...]]:
    """Return the variables of the targets' states, of the tracks of the nodes, and GOSPA; of one
    run, whose readings (1, steps, N, 1 + D, 2) are given, also those of the centre."""
    centres: dict[int, TrackLog] = {}
    if len(tracks) == 1 and readings is not None:
        everybody = range(setup.scenario.nodes)
        centres[CENTRE] = log_alone(setup, everybody, readings[0], tracks[0].paths)
    found, which = _ragged(setup, [_sorted_rows(one, centres) for one in tracks])
    run = np.array(runs)[which]
    names = [f"{one}/{name}" for one, name in zip(run, found["trajectory"][1], strict=True)]
    gospa = np.stack([one.distances() for one in tracks])
    return {
        **found,
        "trajectory": (*found["trajectory"][:1], names, *found["trajectory"][2:]),
        _RUN: (found["tracker"][0], run, {"long_name": "number of the run"}),
        "gospa": (("run", "step", "node"), gospa, {"units": "m", "cutoff": CUTOFF_M}),
    }


def read_tracks(data: "xarray.Dataset", setup: Setup, there: np.ndarray) -> tuple[TracksTrace, ...]:
    """Return the tracks of each run of a data set, without digests; none without any.

    Nodes take part `there` (R, steps, N).
    """
    if _RUN not in data:
        return ()
    sizes = data["row_size"].to_numpy()
    tracker, run = (np.repeat(data[name].to_numpy(), sizes) for name in ("tracker", _RUN))
    identity = np.repeat(data["identity"].to_numpy(), sizes, axis=0)
    rows = np.column_stack((identity, *(data[f"track_{name}"].to_numpy() for name in _COLUMNS)))
    step = data["track_step"].to_numpy()
    order = np.lexsort((step, tracker, run))
    places = np.stack((run, tracker, step))[:, order]
    begins = np.flatnonzero(np.diff(places, prepend=np.nan).any(axis=0))
    at_place = map(tuple, places[:, begins].T.tolist())
    told = dict(zip(at_place, np.split(rows[order], begins[1:]), strict=True))
    targets = swarm_of(setup.scenario).targets
    found = []
    for number, at in zip(data["run"].to_numpy().tolist(), there, strict=True):
        paths = np.full((len(at), targets, len(_NAMES)), np.nan)
        logs = tuple(TrackLog() for _ in range(at.shape[1]))
        for place in range(len(at)):
            true = told.get((number, TRUTH, place), _NO_ROWS)
            paths[place, true[:, 0].astype(int)] = report_of(true).mean
            for node in np.flatnonzero(at[place]).tolist():
                reported = report_of(told.get((number, node, place), _NO_ROWS))
                logs[node].add(place, paths[place], reported)
        found.append(TracksTrace(paths, logs, {}))
    return tuple(found)


def _sorted_rows(tracks: TracksTrace, more: Mapping[int, TrackLog]) -> np.ndarray:
    """Rows of truth and nodes, and of other trackers by their numbers."""
    logs = {**more, **dict(enumerate(tracks.logs))}
    rows = np.concatenate(
        [_true_rows(tracks.paths), *(_rows(number, log) for number, log in logs.items())]
    )
    return rows[np.lexsort(rows[:, _KEYS::-1].T)]


def _ragged(
    setup: Setup, rows_of_runs: Sequence[np.ndarray]
) -> tuple[dict[str, tuple[Any, ...]], np.ndarray]:
    """The variables of the rows of runs, each in order, and the place of each trajectory's run."""
    rows = np.concatenate(rows_of_runs)
    run = np.repeat(np.arange(len(rows_of_runs)), [len(one) for one in rows_of_runs])
    keys = np.column_stack((run, rows[:, :_KEYS].astype(int)))
    starts = np.flatnonzero(np.diff(keys, axis=0, prepend=TRUTH - 1).any(axis=1))
    sizes = np.diff(starts, append=len(rows))
    numbers = keys[starts]
    names = [f"{tracker}/{'-'.join(map(str, key))}" for _, tracker, *key in numbers.tolist()]
    time = {
        "standard_name": "time",
        "units": "seconds since 2000-01-01 00:00:00",
        "comment": "the run begins at this nominal date",
    }
    units = ("1", *_UNITS, *_UNITS)
    observed = {
        f"track_{name}": ("obs", value, {"units": unit} | ({} if name in "xy" else _AT))
        for name, value, unit in zip(_COLUMNS, rows[:, _KEYS + 1 :].T, units, strict=True)
    }
    trackers = f"number of the node; {TRUTH} is the truth, {CENTRE} the centre"
    identities = (
        "step, node and place in the scan of the first detection; number of the target for the "
        "truth"
    )
    of_rows = {"long_name": "observations of a trajectory", "sample_dimension": "obs"}
    variables = {
        "trajectory": ("trajectory_number", names, {"cf_role": "trajectory_id"}),
        "row_size": ("trajectory_number", sizes, of_rows),
        "tracker": ("trajectory_number", numbers[:, 1], {"long_name": trackers}),
        "identity": (("trajectory_number", "label"), numbers[:, 2:], {"long_name": identities}),
        "track_step": ("obs", rows[:, _KEYS].astype(int), {"units": "1"}),
        "track_time": ("obs", rows[:, _KEYS] * setup.time_step_s, time),
        **observed,
    }
    return variables, numbers[:, 0]


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
