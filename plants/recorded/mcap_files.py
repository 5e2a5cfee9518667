"""Logs in MCAP files with ROS 2 messages."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from concord.plants.recorded.log_file import LogFile

_LONGEST_ARRAY = 36
"""Numbers of an array that are series of their own: a covariance of six rows, and no image."""


class McapFile(LogFile):
    """Numbers in the messages of each topic: `/imu.angular_velocity.z`, `/wheels.data[2]`.

    A message is stamped by its header. It is stamped by the time of its record where it has no
    header, or where all headers of its topic are 0. Times of 1970 and later are exact to 0.3 us.
    Topics that cannot be decoded, such as service events, are left out.
    """

    def __init__(self, file: Path) -> None:
        """Read the names of the fields of all messages.

        Raises:
            ValueError: the extra `logs` is missing, or the file cannot be read.
        """
        self._file = file
        fields: dict[str, dict[str, float]] = {}
        unread: dict[str, None] = {}
        for topic, _, numbers in _messages(file, None):
            if numbers is None:
                unread[topic] = None
            else:
                fields.setdefault(topic, {}).update(numbers)
        self.unread = tuple(unread)
        self.names = tuple(
            f"{topic}.{path}"
            for topic, paths in fields.items()
            if topic not in unread
            for path in paths
        )
        self._topic = cache(self._read_topic)

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a field, NaN in a message without it."""
        topic, _, path = name.partition(".")  # names of topics have no point
        return np.array([numbers.get(path, np.nan) for _, numbers in self._topic(topic)])

    def stamps_s(self, name: str) -> np.ndarray:
        """Return the times (n,) of the messages that hold a field."""
        topic, _, _ = name.partition(".")
        logged_s = np.array([logged_s for logged_s, _ in self._topic(topic)])
        stamps_s = np.array([n.get("header.stamp", np.nan) for _, n in self._topic(topic)])
        if len(stamps_s) > 1 and not stamps_s.any():
            return logged_s  # the program that sent them left the stamps empty
        return np.where(np.isnan(stamps_s), logged_s, stamps_s)

    def _read_topic(self, topic: str) -> list[tuple[float, dict[str, float]]]:
        messages = _messages(self._file, topic)
        return [(logged_s, numbers) for _, logged_s, numbers in messages if numbers is not None]


def _messages(
    file: Path, topic: str | None
) -> Iterator[tuple[str, float, dict[str, float] | None]]:
    """Yield topic, time of the record in s and numbers of the messages of one topic, or all.

    The numbers are None for the first message of a topic that cannot be decoded, which is the last
    of that topic.
    """
    try:
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise ValueError(
            f"{file}: MCAP needs mcap-ros2-support, which is not installed; run `make extras`, or "
            "`pip install '.[logs]'` in a checkout of concord"
        ) from None
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with file.open("rb") as stream:
            decoders, unread = DecoderFactory(), set[str]()
            topics = None if topic is None else [topic]
            for schema, channel, message in make_reader(stream).iter_messages(topics=topics):
                if channel.topic in unread:
                    continue
                try:
                    decode = decoders.decoder_for(channel.message_encoding, schema)
                    numbers = dict(_numbers(decode(message.data), "")) if decode else None
                except Exception:  # decoders of broken messages raise what they meet
                    numbers = None
                if numbers is None:
                    unread.add(channel.topic)
                yield channel.topic, message.log_time / 1e9, numbers
    except (OSError, McapError) as error:
        raise ValueError(f"{file}: cannot be read as MCAP of ROS 2 ({error})") from None


def _numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    """Yield the path and the value of every number in a message."""
    if isinstance(value, bool | int | float):
        yield path, float(value)
    elif hasattr(value, "nanosec"):
        yield path, value.sec + value.nanosec / 1e9
    elif isinstance(value, list | tuple | np.ndarray):
        for place, entry in enumerate(value if len(value) <= _LONGEST_ARRAY else ()):
            yield from _numbers(entry, f"{path}[{place}]")
    else:
        for field in getattr(value, "__slots__", ()):  # a text has none
            yield from _numbers(getattr(value, field), f"{path}.{field}" if path else field)
