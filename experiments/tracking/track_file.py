"""The tracks of a run as a netCDF file: one trajectory for each identity at each tracker.

Source of the form: CF Conventions 1.11, section H.4.3, contiguous ragged array of trajectories.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from concord.experiments.results.netcdf_file import write_dataset
from concord.experiments.tracking.track_log import TrackLog
from concord.filters.tracking.tracks import IDENTITY
from concord.scenarios.definitions.target_swarm import STATES, TargetSwarm

if TYPE_CHECKING:
    import xarray

TRUTH, CENTRE = -2, -1
"""Numbers of the trajectories that no node has."""
_NAMES = ("x", "vx", "y", "vy")
_UNITS = ("m", "m s-1", "m", "m s-1")
_AT = {"coordinates": "time x y"}
_KEYS = 1 + IDENTITY
"""Columns of a row that tell its trajectory: tracker and identity; its step follows."""


def write_tracks(
    folder: Path, swarm: TargetSwarm, truth: np.ndarray, logs: Mapping[int, TrackLog]
) -> Path:
    """Write tracks_<run>.nc with the reported tracks of the trackers by number, and the truth.

    Raises:
        NotWritten: the disk does not take it.
    """
    path = folder / f"tracks_{swarm.run}.nc"
    write_dataset(track_dataset(swarm, truth, logs), path)
    return path


def track_dataset(
    swarm: TargetSwarm, truth: np.ndarray, logs: Mapping[int, TrackLog]
) -> "xarray.Dataset":
    """Return the true states (steps, K, 4), and what trackers have reported, as trajectories."""
    # Loading xarray takes long, so it is loaded only to write a file.
    import xarray

    rows = np.concatenate([_true_rows(truth), *(_rows(number, logs[number]) for number in logs)])
    rows = rows[np.lexsort(rows[:, _KEYS::-1].T)]
    keys = rows[:, :_KEYS].astype(int)
    starts = np.flatnonzero(np.diff(keys, axis=0, prepend=TRUTH - 1).any(axis=1))
    sizes = np.diff(starts, append=len(rows))
    numbers = keys[starts]
    names = [f"{tracker}/{'-'.join(map(str, key))}" for tracker, *key in numbers.tolist()]
    values = rows[:, _KEYS + 1 :].T
    time_step_s = swarm.setup().time_step_s
    time = {
        "standard_name": "time",
        "units": "seconds since 2000-01-01 00:00:00",
        "comment": "the run begins at this nominal date",
    }
    names_of_rows = (*_NAMES, *(f"{name}_std" for name in _NAMES), "existence")
    units = (*_UNITS, *_UNITS, "1")
    observed = {
        name: ("obs", value, {"units": unit} | ({} if name in "xy" else _AT))
        for name, value, unit in zip(names_of_rows, values, units, strict=True)
    }
    return xarray.Dataset(
        {
            "trajectory": ("trajectory_number", names, {"cf_role": "trajectory_id"}),
            "row_size": (
                "trajectory_number", sizes,
                {"long_name": "observations of a trajectory", "sample_dimension": "obs"},
            ),
            "tracker": (
                "trajectory_number", numbers[:, 0],
                {"long_name": f"number of the node; {TRUTH} is the truth, {CENTRE} the centre"},
            ),
            "identity": (
                ("trajectory_number", "label"), numbers[:, 1:],
                {"long_name": "step, node and place in the scan of the first detection; number "
                              "of the target for the truth"},
            ),
            "step": ("obs", rows[:, _KEYS].astype(int), {"units": "1"}),
            "time": ("obs", rows[:, _KEYS] * time_step_s, time),
            **observed,
        },
        attrs={
            "Conventions": "CF-1.11",
            "featureType": "trajectory",
            "title": "concord track",
            "options": msgspec.json.encode(swarm).decode(),
        },
    )  # fmt: skip


def _true_rows(truth: np.ndarray) -> np.ndarray:
    steps, targets = np.nonzero(np.isfinite(truth).all(axis=-1))
    nothing = np.zeros(len(steps))
    key = (np.full(len(steps), TRUTH), targets, nothing, nothing, steps)
    exact = np.zeros((len(steps), STATES))
    return np.column_stack((*key, truth[steps, targets], exact, np.ones(len(steps))))


def _rows(number: int, log: TrackLog) -> np.ndarray:
    """Rows of tracker, identity, step, state, standard deviations and existence."""
    rows = [np.empty((0, _KEYS + 1 + 2 * STATES + 1))]
    for step, tracks in log.reported:
        count = len(tracks.existence)
        deviations = np.sqrt(np.diagonal(tracks.belief.cov, axis1=-2, axis2=-1))
        rows.append(
            np.column_stack(
                (
                    np.full(count, number), tracks.identity, np.full(count, step),
                    tracks.belief.mean, deviations, tracks.existence,
                )
            )
        )  # fmt: skip
    return np.concatenate(rows)
