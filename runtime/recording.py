"""The log of a run: every message as it travelled, in memory or in an MCAP file.

A file is written without chunks, so that it can be read up to the last message after a crash. Times
are the plant's, not the clock's.
"""

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import msgspec
from mcap.records import Channel, Metadata
from mcap.records import Message as McapMessage
from mcap.writer import Writer

from concord.bus.bus import FrameFormat
from concord.disk import NotWritten, writing
from concord.nodes.bounds import UNREADABLE, Instant
from concord.nodes.history import history_of, with_event
from concord.nodes.messages import MalformedMessage, decode, message_types
from concord.scenarios.setup import Setup

ORIGIN = "concord"
"""Name of the metadata record that says of which run a recording is."""
MESSAGE_BYTES = 31
"""Bytes of a recorded message beside its data: kind, length, channel, number and two times."""
DAMAGE = "damage"
"""Topic of what stands for bytes of a recording that are no message."""


def origin_of(setup: Setup, run: str) -> dict[str, str]:
    """Return what says of which run a file is: its name, scenario, seed, steps and setup."""
    scenario = setup.scenario
    digest = hashlib.sha256(msgspec.json.encode(setup)).hexdigest()[:16]
    return {
        "run": run,
        "scenario": scenario.name,
        "seed": str(scenario.seed),
        "steps": str(scenario.steps),
        "setup": digest,
    }


class Recorder(Protocol):
    """Keeps messages as they travelled; closes what it opened."""

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Keep messages, (topic, bytes), in this order."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


class MemoryRecorder:
    """Keeps messages in a list of (topic, bytes)."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, bytes]] = []

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Keep messages, (topic, bytes), in this order."""
        self.messages.extend(messages)

    def close(self) -> None:
        """Nothing to do: memory needs no end."""


class _Stamp(msgspec.Struct):
    """The time of any JSON message; a message without one counts as current."""

    step: Instant | None = None
    cycle: Instant | None = None


_stamp = msgspec.json.Decoder(_Stamp)


class McapRecorder:
    """Keeps messages in an MCAP file.

    Raises a `NotWritten` where the disk is full, and is closed then; what is whole stays in the
    file.
    """

    def __init__(
        self,
        path: Path,
        rounds: int,
        time_step_s: float,
        frame_format: FrameFormat,
        origin: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """`origin` says of which run the messages are, in a metadata record (`ORIGIN`)."""
        self._frames = frame_format
        self._history = history_of(rounds, ())
        self._last_ns = 0
        self._step_ns = round(time_step_s * 1e9)
        self._path, self._origin = path, origin
        with writing(path):
            self._begin()

    def _begin(self) -> None:
        self._file = self._path.open("wb")
        self._writer = Writer(self._file, use_chunking=False)
        self._writer.start(profile="", library="concord")
        if self._origin:
            self._writer.add_metadata(ORIGIN, dict(self._origin))
        self._schemas = {
            topic: self._writer.register_schema(
                name=type_.__name__,
                encoding="jsonschema",
                data=msgspec.json.encode(msgspec.json.schema(type_)),
            )
            for topic, type_ in message_types().items()
        }
        self._channels: dict[str, int] = {}
        self._sequence = 0
        self._file.flush()
        self._whole_bytes = self._file.tell()
        self._is_whole = True

    def record(self, messages: Sequence[tuple[str, bytes]]) -> None:
        """Keep messages, (topic, bytes), in this order."""
        try:
            # Ctrl-C may strike between any two of these lines: what it leaves is not whole.
            self._is_whole = False
            for topic, data in messages:
                self._append(topic, data)
            # Flushed messages survive the death of this process.
            self._file.flush()
            self._whole_bytes = self._file.tell()
            self._is_whole = True
        except OSError as error:
            self.close()
            raise NotWritten(self._path, error) from error

    def _append(self, topic: str, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(topic)
        time_ns = self._time_ns(topic, data)
        self._writer.add_message(channel, time_ns, data, time_ns, self._sequence)
        self._sequence += 1

    def _register(self, topic: str) -> int:
        schema = self._schemas.get(topic.partition("/")[0], 0)
        encoding = "json" if schema else self._frames.name
        return self._writer.register_channel(topic, encoding, schema)

    def _time_ns(self, topic: str, data: bytes) -> int:
        if topic.startswith("share/"):
            return self._history.place(self._frames.cycle_of(data))[0] * self._step_ns
        try:
            if topic == "event":
                self._history = with_event(self._history, decode(topic, data))
            stamp = _stamp.decode(data)
        except (*UNREADABLE, MalformedMessage):
            # Kept as received, for a search of its sender; its time is unknown.
            return 0
        if stamp.step is not None:
            self._last_ns = stamp.step * self._step_ns
        elif stamp.cycle is not None:
            self._last_ns = self._history.place(stamp.cycle)[0] * self._step_ns
        return self._last_ns

    def close(self) -> None:
        """Write the index and close the file; what was interrupted is cut off instead."""
        if self._file.closed:
            return
        end: int | None = None
        try:
            if self._is_whole:
                self._is_whole = False
                end = self._file.tell()
                with writing(self._path):
                    self._writer.finish()
                    self._file.flush()
                end = self._file.tell()
        finally:
            with suppress(OSError):
                # Data that a full disk refuses here did not belong to a whole record.
                self._file.close()
            with suppress(FileNotFoundError):
                # Another process may have removed the file meanwhile.
                os.truncate(self._path, end or self._whole_end())

    def _whole_end(self) -> int:
        # Only here: a file that was closed in order needs no reader.
        from concord.runtime.recording_file import whole_bytes

        return whole_bytes(self._path, self._whole_bytes)


def read_recording(path: Path) -> Iterator[tuple[str, bytes]]:
    """The (topic, bytes) of a recording in file order; a torn last record is left out.

    Damage in the middle is a message on the topic `DAMAGE`, whose data is its length in bytes.

    Raises:
        ValueError: the file is not an MCAP recording.
    """
    # Only here: a network writes recordings and reads none.
    from concord.runtime.recording_file import Damage, whole_records

    topics: dict[int, str] = {}
    for record in whole_records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, McapMessage):
            topic = topics.get(record.channel_id)
            yield (DAMAGE, b"%d" % len(record.data)) if topic is None else (topic, record.data)
        elif isinstance(record, Damage):
            yield DAMAGE, b"%d" % record.length


def recorded_origin(path: Path) -> dict[str, str]:
    """Return what a recording says of its run (`origin_of`); nothing where it says nothing.

    Raises:
        ValueError: the file is not an MCAP recording.
    """
    from concord.runtime.recording_file import whole_records  # as above

    for record in whole_records(path):
        if isinstance(record, Metadata) and record.name == ORIGIN:
            return record.metadata
        if isinstance(record, McapMessage):
            break
    return {}
