"""Logs in MCAP files with ROS 2 messages."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_LONGEST_ARRAY = 36
"""Numbers of an array that are series of their own: a covariance of six rows, and no image."""


class McapFile:
    """Numbers in the messages of each topic: `/imu.angular_velocity.z`, `/wheels.data[2]`.

    A message is stamped by its header, or by the time of its record where it has none. Times count
    from 1970, exact to 0.3 us.
    """

    def __init__(self, file: Path) -> None:
        """Read the first message of every topic.

        Raises:
            ValueError: the extra `logs` is missing, or the file cannot be read.
        """
        self._file = file
        firsts: dict[str, dict[str, float]] = {}
        for topic, _, numbers in _messages(file, None):
            firsts.setdefault(topic, numbers)
        self.names = tuple(f"{topic}.{path}" for topic, paths in firsts.items() for path in paths)
        self._topic = cache(self._read_topic)

    def series(self, name: str) -> np.ndarray:
        """Return the numbers (n,) of a field, NaN in a message without it."""
        topic, _, path = name.partition(".")  # names of topics have no point
        return np.array([numbers.get(path, np.nan) for _, numbers in self._topic(topic)])

    def stamps_s(self, name: str) -> np.ndarray:
        """Return the times (n,) of the messages that hold a field."""
        topic, _, _ = name.partition(".")
        return np.array(
            [numbers.get("header.stamp") or logged_s for logged_s, numbers in self._topic(topic)]
        )

    def _read_topic(self, topic: str) -> list[tuple[float, dict[str, float]]]:
        messages = _messages(self._file, topic)
        return [(logged_s, numbers) for _, logged_s, numbers in messages]


def _messages(file: Path, topic: str | None) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Yield topic, time of the record in s and numbers of the messages of one topic, or all."""
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
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for decoded in reader.iter_decoded_messages(topics=None if topic is None else [topic]):
                logged_s = decoded.message.log_time / 1e9
                yield decoded.channel.topic, logged_s, dict(_numbers(decoded.decoded_message, ""))
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
