"""Recordings whose recorder died: the summary and footer that other readers of MCAP need."""

import os
from collections import Counter
from pathlib import Path
from typing import IO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Message, Schema, Statistics, SummaryOffset
from mcap.writer import MCAP0_MAGIC

from concord.runtime.recording_file import (
    HEADER,
    SKIPPED,
    Damage,
    RecordFile,
    Span,
    check_start,
)


def finish_recording(path: Path) -> bool:
    """Finish an unfinished recording in place: cut its torn record, append summary and footer.

    One pass reads the file by blocks and copies nothing. Damage that has records behind it gets the
    header of a private record, which other readers pass over. Unfinished files of processes that
    are gone are removed beside it. Where the disk has no room for the summary, the recording ends
    with its last whole record, and all readers of ours take it.

    Returns whether the recording was unfinished. A missing file is none.

    Raises:
        ValueError: the file is no recording.
    """
    _remove_parts(path.parent)
    if not path.is_file() or _is_finished(path):
        return False
    with path.open("rb+") as file:
        check_start(path, file)
        if path.stat().st_size < len(MCAP0_MAGIC):
            return False
        summary = _Summary()
        try:
            end = summary.read(file)
        except ValueError as error:
            raise ValueError(f"{path}: not a recording of concord ({error})") from None
        for span in summary.damage:
            os.pwrite(file.fileno(), _private_header(span), span.start)
        file.truncate(end)
        try:
            os.pwrite(file.fileno(), summary.bytes_at(end), end)
        except OSError:
            file.truncate(end)
    return True


def _private_header(span: Span) -> bytes:
    return HEADER.pack(SKIPPED, span.end - span.start - HEADER.size)


def _is_finished(path: Path) -> bool:
    """Return whether a file ends as a closed MCAP file does: with its magic again."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)))
        return file.read() == MCAP0_MAGIC


def _remove_parts(folder: Path) -> None:
    """Remove the unfinished files (`concord.disk.whole_file`) of processes that are gone."""
    for left in folder.glob("*.part"):
        owner = left.suffixes[-2].removeprefix(".") if len(left.suffixes) > 1 else ""
        if owner.isdecimal() and not _is_there(int(owner)):
            left.unlink(missing_ok=True)


def _is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


class _Summary:
    """Findings of a pass over the records of a file, for its summary section."""

    def __init__(self) -> None:
        self.damage: list[Span] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._times_ns: tuple[int, int] | None = None
        self._metadata = 0

    def read(self, file: IO[bytes]) -> int:
        """Read all records; return the end of the last whole one.

        Raises:
            ValueError: it is no recording of ours.
        """
        records, end = RecordFile(file), len(MCAP0_MAGIC)
        for span in records.spans():
            if span.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            end = span.end
            record = records.record(span)
            if isinstance(record, Damage):
                self.damage.append(span)
            elif isinstance(record, Message):
                self._counts[record.channel_id] += 1
                low, high = self._times_ns or (record.log_time, record.log_time)
                self._times_ns = min(low, record.log_time), max(high, record.log_time)
            elif isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._channels[record.id] = record
            elif record is not None:
                self._metadata += 1
        return end

    def bytes_at(self, start: int) -> bytes:
        """Return the end of a file whose records end at `start`: from its data-end record on."""
        built = RecordBuilder()
        DataEnd(data_section_crc=0).write(built)
        summary_start = start + built.count
        low, high = self._times_ns or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=0,
            message_count=self._counts.total(),
            message_end_time=high,
            message_start_time=low,
            metadata_count=self._metadata,
            schema_count=len(self._schemas),
        )
        groups = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
        )
        offsets = []
        for opcode, records in groups:
            first = built.count
            for record in records:
                record.write(built)
            offsets.append(SummaryOffset(opcode, start + first, built.count - first))
        offset_start = start + built.count
        for offset in offsets:
            offset.write(built)
        Footer(summary_start=summary_start, summary_offset_start=offset_start, summary_crc=0).write(
            built
        )
        return bytes(built.end()) + MCAP0_MAGIC
