"""Logs in MCAP files with ROS 2 messages."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from concord.plants.recorded.log_file import LogFile

if TYPE_CHECKING:
    from mcap.records import Channel, Chunk, Message, Schema

_MOST_CHUNK_BYTES, _MOST_UNPACKED_BYTES = 16_000_000, 100_000_000
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

    @property
    def stamping(self) -> tuple[str, ...]:
        """The stamps in headers."""
        return tuple(name for name in self.names if name.endswith(".header.stamp"))

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
        known = ((logged_s, numbers) for _, logged_s, numbers in messages if numbers is not None)
        return sorted(known, key=lambda one: one[0])


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
    try:
        with file.open("rb") as stream:
            decoders, unread = DecoderFactory(), set[str]()
            for schema, channel, message in recorded_messages(stream, file.stat().st_size):
                if channel.topic in unread or topic not in (None, channel.topic):
                    continue
                try:
                    decode = decoders.decoder_for(channel.message_encoding, schema)
                    numbers = dict(_numbers(decode(message.data), "")) if decode else None
                except Exception:  # decoders of broken messages raise what they meet
                    numbers = None
                if numbers is None:
                    unread.add(channel.topic)
                yield channel.topic, message.log_time / 1e9, numbers
    except Exception as error:  # the library of MCAP raises what it meets in broken files
        why = str(error).partition("\n")[0] or type(error).__name__
        raise ValueError(f"{file}: cannot be read as MCAP of ROS 2 ({why[:200]})") from None


def recorded_messages(
    stream: IO[bytes], size_bytes: int
) -> "Iterator[tuple[Schema | None, Channel, Message]]":
    """Yield the messages of a file in file order, with their schemas and channels.

    Raises:
        ValueError: a chunk claims far more than it holds.
        McapError: the file is damaged.
    """
    from mcap.exceptions import McapError
    from mcap.records import Channel, Chunk, Message, Schema
    from mcap.stream_reader import StreamReader, breakup_chunk

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    records = StreamReader(stream, emit_chunks=True, record_size_limit=size_bytes).records
    for outer in records:
        if isinstance(outer, Chunk):
            _check_claim(outer)
        for record in breakup_chunk(outer) if isinstance(outer, Chunk) else (outer,):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    raise McapError(f"no channel record with id {record.channel_id}")
                yield schemas.get(channel.schema_id), channel, record


def _check_claim(chunk: "Chunk") -> None:
    """Refuse a chunk that unpacks to more than 100 MB, or to 16 MB and 1000 times its length.

    Raises:
        ValueError: naming both lengths.
    """
    claims = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        import zstandard

        claims.append(zstandard.frame_content_size(chunk.data))
    elif chunk.compression == "lz4":
        import lz4.frame

        claims.append(int(lz4.frame.get_frame_info(chunk.data)["content_size"]))
        # A frame may not say its length; a byte unpacks to 255 at most.
        claims.append(min(255 * len(chunk.data), _unpacked(chunk.data)))
    most = max(_MOST_CHUNK_BYTES, min(1000 * len(chunk.data), _MOST_UNPACKED_BYTES))
    if max(claims) > most:
        raise ValueError(f"a chunk of {len(chunk.data)} bytes unpacks to {max(claims)}")


def _unpacked(data: bytes) -> int:
    """Return the length to which an lz4 frame unpacks, or more than the most where it is longer."""
    import lz4.frame

    unpacker, length = lz4.frame.LZ4FrameDecompressor(), 0
    while length <= _MOST_UNPACKED_BYTES and not unpacker.eof:
        part = unpacker.decompress(data, max_length=_MOST_CHUNK_BYTES)
        length, data = length + len(part), b""
        if not part and unpacker.needs_input:
            break
    return length


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
