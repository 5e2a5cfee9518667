"""Evidence of a run: run.json, its recorded messages in plain form, and the arrays of run.nc."""

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
from mcap.records import Channel
from mcap.records import Message as McapMessage

from concord.bus.bus import FrameFormat, Rejected
from concord.nodes.changes import Event, Gone
from concord.nodes.history import history_of, with_event
from concord.nodes.messages import (
    Bid,
    Estimate,
    Grant,
    MalformedMessage,
    Measured,
    Truth,
    decode,
    from_wire,
    is_topic,
)
from concord.results.folder import read_description, read_description_file, recording_of
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION, RECORDING, read_dataset
from concord.runtime.recording import DAMAGE, origin_of, recorded_origin
from concord.runtime.recording_file import Damage, whole_records
from concord.scenarios.bus_table.bus_definition import frame_format
from concord.scenarios.scenario import Scenario
from concord.scenarios.user.trust import require_known

if TYPE_CHECKING:
    import xarray

_NAMES = (
    "run",
    "time",
    "truth",
    "mean",
    "cov",
    "nees",
    "payload_bytes",
    "asked",
    "ages",
    "readings",
)
# More than any cycle has: a cycle and its group as one number, in the order of the run.
MOST_GROUPS = 1 << 16


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
        origins: what run.json, run.mcap and run.nc each say of their run (`origin_of`); empty where
            a file says nothing.
        truths: states (n,) of all records by step. estimates, heartbeats, readings: all records by
            (step, node); a heartbeat is the list of its changes. bids: those that ask for a slot or
            for none, by (cycle, node); grants: the winners, by (cycle, group). frames: number of
            records by (cycle, node), then by their bytes. events: (step, change) in order.
        given_up: nodes of which a `gone` to all tells.
        unreadable: messages that are no message of their topic, or of no node of the network.
        misplaced: messages that stand after a later one of their topic, or at another time.
    """

    scenario: Scenario
    arrays: "xarray.Dataset"
    in_real_time: bool
    origins: dict[str, dict[str, str]]
    truths: dict[int, list[np.ndarray]]
    estimates: dict[tuple[int, int], list[RecordedEstimate]]
    heartbeats: dict[tuple[int, int], list[list[Any]]]
    readings: dict[tuple[int, int], np.ndarray]
    bids: dict[tuple[int, int], list[bool]]
    grants: dict[tuple[int, int], list[list[int]]]
    frames: dict[tuple[int, int], Counter[bytes]]
    events: list[tuple[int, dict[str, Any]]]
    given_up: list[int]
    unreadable: list[str]
    misplaced: list[str]


def read_evidence(folder: Path) -> Evidence:
    """Read run.json, run.mcap and run.nc of a folder.

    Raises:
        ValueError: one of them is missing or damaged, with the command that mends it.
    """
    recording = recording_of(folder)
    if not (folder / ARRAYS).exists():
        raise ValueError(f"{folder}: it holds no {ARRAYS}; `concord collect {folder}` makes it")
    described = read_description_file(folder / DESCRIPTION)
    read_description(folder)
    again = f"`concord collect {folder}` makes it again"
    arrays = read_dataset(folder / ARRAYS, _NAMES, again).isel(run=0)
    try:
        scenario = msgspec.json.decode(arrays.attrs["scenario"], type=Scenario)
        told = msgspec.json.decode(arrays.attrs.get("origin", "{}"), type=dict[str, str])
    except (KeyError, msgspec.MsgspecError) as error:
        raise ValueError(f"{folder / ARRAYS}: names no scenario ({error}); {again}") from None
    require_known(scenario, folder)
    origins = {
        DESCRIPTION: origin_of(described.setup, described.run),
        RECORDING: recorded_origin(recording),
        ARRAYS: told,
    }
    found = Evidence(scenario, arrays, False, origins, {}, {}, {}, {}, {}, {}, {}, [], [], [], [])
    steps_ns = round(described.setup.time_step_s * 1e9)
    reader = _Reader(found, frame_format(scenario), steps_ns)
    in_real_time = False
    for topic, data, time_ns in _messages(recording):
        in_real_time = in_real_time or topic.startswith("timing/")
        reader.take(topic, data, time_ns)
    return found._replace(in_real_time=in_real_time)


def _messages(path: Path) -> Iterator[tuple[str, bytes, int]]:
    topics: dict[int, str] = {}
    for record in whole_records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, McapMessage):
            yield topics.get(record.channel_id, DAMAGE), record.data, record.log_time
        elif isinstance(record, Damage):
            yield DAMAGE, b"%d" % record.length, 0


class _Reader:
    """Files the messages of a recording into its evidence."""

    def __init__(self, found: Evidence, frames: FrameFormat, step_ns: int) -> None:
        self._found, self._frames, self._step_ns = found, frames, step_ns
        self._history = history_of(found.scenario.rounds, ())
        self._latest: dict[str, int] = {}

    def take(self, topic: str, data: bytes, time_ns: int) -> None:
        """File one message; bytes that are none are counted."""
        kind, _, owner = topic.partition("/")
        try:
            if not is_topic(topic, self._found.scenario.nodes):
                raise MalformedMessage(f"no message travels on topic {topic[:60]!r}")
            if kind == "share":
                fragment = self._frames.read(data)
                place = fragment.cycle, int(owner)
                self._found.frames.setdefault(place, Counter())[data] += 1
                self._look(topic, fragment.cycle, self._history.place(fragment.cycle)[0], time_ns)
                return
            message = decode(topic, data)
            if kind == "event":
                self._history = with_event(self._history, message)
            self._file(topic, message, json.loads(data))
        except (ValueError, KeyError, TypeError, StopIteration, Rejected) as error:
            self._found.unreadable.append(f"{topic[:60]}: {str(error)[:120]}")
            return
        if isinstance(message, Measured | Truth | Estimate):
            self._look(topic, message.step, message.step, time_ns)
        elif isinstance(message, Bid | Grant):
            order = message.cycle * MOST_GROUPS + message.group
            self._look(topic, order, self._history.place(message.cycle)[0], time_ns)

    def _look(self, topic: str, order: int, step: int, time_ns: int) -> None:
        """Note a message that stands after a later one, or at another time than its step's."""
        if order < self._latest.get(topic, -1):
            self._found.misplaced.append(f"step {step}: {topic} after a later one")
        elif time_ns != step * self._step_ns:
            self._found.misplaced.append(f"step {step}: {topic} at {time_ns / 1e9:g} s")
        self._latest[topic] = max(order, self._latest.get(topic, -1))

    def _file(self, topic: str, message: Any, told: dict[str, Any]) -> None:
        found = self._found
        match message:
            case Truth():
                found.truths.setdefault(message.step, []).append(floats(told["state"]))
            case Measured():
                place = message.step, message.node
                found.heartbeats.setdefault(place, []).append(told.get("changes", []))
                found.readings[place] = from_wire(message.readings)
            case Estimate():
                said = RecordedEstimate(
                    floats(told["mean"]),
                    floats(told["cov"]),
                    message.counters,
                    message.age_s,
                    message.absent,
                )
                found.estimates.setdefault((message.step, message.node), []).append(said)
            case Bid():
                place = message.cycle * MOST_GROUPS + message.group, message.node
                found.bids.setdefault(place, []).append(message.bid is not None)
            case Grant():
                place = message.cycle, message.group
                found.grants.setdefault(place, []).append(message.winners)
            case Event():
                found.events.append((message.step, told["change"]))
            case Gone() if topic == "gone":
                found.given_up.append(message.node)


def floats(values: list[float | None]) -> np.ndarray:
    """Return recorded numbers (n,), NaN where one was null."""
    return np.array([math.nan if value is None else value for value in values], dtype=float)
