"""The records of an MCAP file in one pass, past a torn end and over damage in the middle.

Source: MCAP format specification: opcode (1 byte), length (8 bytes), content.
"""

import os
import re
import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

SKIPPED = 0x80
"""Opcode of a private record, which other readers pass over: damage that a repair has covered."""
HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_READ: dict[int, Callable[[ReadDataStream], Schema | Channel | Metadata]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
}
_LAST = (Opcode.DATA_END, Opcode.FOOTER)
# The longest message that a process takes from its links.
_LONGEST = 1 << 26
_BLOCK_BYTES = 1 << 20
# Beside a JSON object, a frame of a bus is all that a message holds.
_LONGEST_FRAME = 262
_ENOUGH_RECORDS = 8
_CANDIDATE = re.compile(rb"(?=\x05.{4}\x00{4})", re.DOTALL)


class Damage(NamedTuple):
    """Bytes that are no record, and have records behind them."""

    length: int


Record = Schema | Channel | Metadata | Message | Damage


class Span(NamedTuple):
    """Place of a record: opcode (`SKIPPED` for damage), first byte and the one behind it."""

    opcode: int
    start: int
    end: int


class RecordFile:
    """The bytes of a file that is open for reading, by blocks."""

    def __init__(self, file: IO[bytes]) -> None:
        self._descriptor, self._block, self._base = file.fileno(), b"", 0
        self.size = os.fstat(self._descriptor).st_size

    def read(self, start: int, length: int) -> bytes:
        """Return bytes of the file, fewer at its end."""
        first = start - self._base
        if first < 0 or first + length > len(self._block):
            self._base, first = start, 0
            self._block = os.pread(self._descriptor, max(length, _BLOCK_BYTES), start)
        return self._block[first : first + length]

    def spans(self) -> Iterator[Span]:
        """Yield the whole records in file order, and damage that has records behind it."""
        at = len(MCAP0_MAGIC)
        while at < self.size:
            span = self._sound(at)
            if span is None:
                found = self._next_sound(at + HEADER.size)
                if found is None:
                    return
                yield Span(SKIPPED, at, found)
                at = found
                continue
            yield span
            if span.opcode in _LAST:
                return
            at = span.end

    def _sound(self, at: int) -> Span | None:
        """Return the record at a place; None where there is none, or a torn one."""
        header = self._header(at)
        if header is None or at + HEADER.size + header[1] > self.size:
            return None
        opcode, length = header
        span = Span(opcode, at, at + HEADER.size + length)
        if opcode == Opcode.MESSAGE:
            # Bytes of an intruder are kept too: then the records behind have to tell.
            return span if self._looks_whole(span) or self._follow(span.end) else None
        is_last = span.end + HEADER.size > self.size
        return span if is_last or self._header(span.end) else None

    def _follow(self, at: int) -> bool:
        """Whether several records follow, or as many as there are."""
        for _ in range(_ENOUGH_RECORDS):
            if at + HEADER.size > self.size:
                return at == self.size
            if (header := self._header(at)) is None:
                return False
            if header == (Opcode.FOOTER, 0):
                return True
            at += HEADER.size + header[1]
        return True

    def _header(self, at: int) -> tuple[int, int] | None:
        read = self.read(at, HEADER.size)
        if read == MCAP0_MAGIC:
            return Opcode.FOOTER, 0
        if len(read) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(read)
        least = _MESSAGE.size if opcode == Opcode.MESSAGE else 0
        known = 1 <= opcode <= Opcode.DATA_END or opcode == SKIPPED
        return (opcode, length) if known and least <= length <= self._most(opcode) else None

    def _most(self, opcode: int) -> int:
        return self.size if opcode in (SKIPPED, Opcode.CHUNK) else _LONGEST

    def _looks_whole(self, span: Span) -> bool:
        """Whether a message ends as messages do."""
        length = span.end - span.start - HEADER.size - _MESSAGE.size
        first, last = (self.read(at, 1) for at in (span.end - length, span.end - 1))
        return last == b"}" if first == b"{" else length <= _LONGEST_FRAME

    def _next_sound(self, at: int) -> int | None:
        """Return the next place of a message with records behind it; None for none."""
        while at < self.size:
            # Over the end of a block, so that no header is cut.
            block = self.read(at, _BLOCK_BYTES)
            for found in _CANDIDATE.finditer(block):
                place = at + found.start()
                span = self._sound(place)
                if span is None or not self._looks_whole(span):
                    continue
                if self._header(span.end) or span.end == self.size:
                    return place
            at += max(len(block) - HEADER.size, 1)
        return None

    def record(self, span: Span) -> Record | None:
        """Return a record; None for one of a kind that holds no message of ours.

        Raises:
            ValueError: a compressed chunk, which no recording of ours has.
        """
        if span.opcode == SKIPPED:
            return Damage(span.end - span.start)
        if span.opcode == Opcode.CHUNK:
            raise ValueError("it has chunks, as no recording of concord")
        start = span.start + HEADER.size
        content = self.read(start, span.end - start)
        if span.opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
            return Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)
        if (read := _READ.get(span.opcode)) is None:
            return None
        try:
            return read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, UnicodeDecodeError):
            return Damage(span.end - span.start)


def whole_records(path: Path) -> Iterator[Record]:
    """Yield the records of an MCAP file in file order; a torn last one is left out.

    Raises:
        ValueError: the file is not an MCAP recording of ours.
    """
    with path.open("rb") as file:
        check_start(path, file)
        read = RecordFile(file)
        for span in read.spans():
            try:
                record = read.record(span)
            except ValueError as error:
                raise ValueError(f"{path}: not a recording of concord ({error})") from None
            if record is not None:
                yield record


def check_start(path: Path, file: IO[bytes]) -> None:
    """Refuse a file that begins as no MCAP file does.

    Raises:
        ValueError: naming the file.
    """
    if not MCAP0_MAGIC.startswith(file.read(len(MCAP0_MAGIC))):
        raise ValueError(f"{path}: not a recording of concord; name the run.mcap of a run folder")


def whole_bytes(path: Path, since: int) -> int:
    """Return the length of a file up to its last whole record, of which `since` bytes are whole."""
    with path.open("rb") as file:
        read, end = RecordFile(file), since
        while end + HEADER.size <= read.size:
            _, length = HEADER.unpack(read.read(end, HEADER.size))
            if end + HEADER.size + length > read.size:
                break
            end += HEADER.size + length
    return end


def is_closed(path: Path) -> bool:
    """Say whether the writer of a recording has closed it in order."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MCAP0_MAGIC)))
        return size > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC
