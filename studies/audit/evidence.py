"""Evidence of a run: its recorded messages in plain form, and the arrays of run.nc."""

import json
import math
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from concord.bus.bus import FrameFormat, Rejected
from concord.results.folder import recording_of
from concord.results.records.netcdf_file import ARRAYS, read_dataset
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.scenario import Scenario
from concord.scenarios.user.trust import require_known

if TYPE_CHECKING:
    import xarray

_NAMES = ("run", "truth", "mean", "cov", "nees", "payload_bytes", "ages")


class RecordedEstimate(NamedTuple):
    """A recorded estimate: mean (n,), upper triangle of the covariance, total counters, its age in
    real time (None: it does not say), and the nodes that its sender takes for out."""

    mean: np.ndarray
    cov: np.ndarray
    counters: dict[str, int]
    age_s: float | None = None
    absent: tuple[int, ...] = ()


class Evidence(NamedTuple):
    """Recorded messages of a run of N nodes, and its arrays.

    Attributes:
        scenario: as run.nc names it. arrays: run.nc. in_real_time: nodes kept a timetable.
        truths: number of records by step. estimates, heartbeats: all records by (step, node); a
        heartbeat is the list of its changes. frames: number of records by (cycle, node), then by
        their bytes. events: (step, change) in order. given_up: nodes of which a `gone` to all
        tells. unreadable: messages that are no JSON object or no frame.
    """

    scenario: Scenario
    arrays: "xarray.Dataset"
    in_real_time: bool
    truths: Counter[int]
    estimates: dict[tuple[int, int], list[RecordedEstimate]]
    heartbeats: dict[tuple[int, int], list[list[Any]]]
    frames: dict[tuple[int, int], Counter[bytes]]
    events: list[tuple[int, dict[str, Any]]]
    given_up: list[int]
    unreadable: int


def read_evidence(folder: Path) -> Evidence:
    """Read run.mcap and run.nc of a folder.

    Raises:
        ValueError: one of them is missing or damaged, with the command that mends it.
    """
    recording = recording_of(folder)
    if not (folder / ARRAYS).exists():
        raise ValueError(f"{folder}: it holds no {ARRAYS}; `concord collect {folder}` makes it")
    arrays = read_dataset(folder / ARRAYS, _NAMES, f"`concord collect {folder}` makes it again")
    arrays = arrays.isel(run=0)
    scenario = msgspec.json.decode(arrays.attrs["scenario"], type=Scenario)
    require_known(scenario, folder)
    found = Evidence(scenario, arrays, False, Counter(), {}, {}, {}, [], [], 0)
    frames = frame_format(scenario)
    unreadable, in_real_time = 0, False
    for topic, data in _messages(recording):
        kind, _, owner = topic.partition("/")
        in_real_time = in_real_time or kind == "timing"
        try:
            if kind == "share":
                _take_frame(found, frames, int(owner), data)
            else:
                _take(found, topic, kind, json.loads(data))
        except (ValueError, KeyError, TypeError, Rejected):
            unreadable += 1
    return found._replace(unreadable=unreadable, in_real_time=in_real_time)


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    try:
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                yield channel.topic, message.data
    except (McapError, struct.error, ValueError) as error:
        raise ValueError(
            f"{path}: it cannot be read ({error or type(error).__name__}); `concord collect "
            f"{path.parent}` finishes the recording of an interrupted run"
        ) from None


def _take_frame(found: Evidence, frames: FrameFormat, node: int, data: bytes) -> None:
    cycle = frames.read(data).cycle
    found.frames.setdefault((cycle, node), Counter())[data] += 1


def _take(found: Evidence, topic: str, kind: str, message: dict[str, Any]) -> None:
    match kind:
        case "truth":
            found.truths[int(message["step"])] += 1
        case "measured":
            place = int(message["step"]), int(message["node"])
            found.heartbeats.setdefault(place, []).append(message.get("changes", []))
        case "estimate":
            place = int(message["step"]), int(message["node"])
            said = RecordedEstimate(
                floats(message["mean"]),
                floats(message["cov"]),
                message["counters"],
                message.get("age_s"),
                tuple(message.get("absent", ())),
            )
            found.estimates.setdefault(place, []).append(said)
        case "event":
            found.events.append((int(message["step"]), message["change"]))
        case "gone" if topic == "gone":
            found.given_up.append(int(message["node"]))


def floats(values: list[float | None]) -> np.ndarray:
    """Return recorded numbers (n,), NaN where one was null."""
    return np.array([math.nan if value is None else value for value in values], dtype=float)
