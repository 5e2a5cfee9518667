"""Recordings whose recorder died: the summary and footer that other readers of MCAP need."""

from pathlib import Path

from mcap.records import Channel, Message, Schema
from mcap.writer import MCAP0_MAGIC, Writer

from concord.disk import whole_file
from concord.runtime.recording import whole_records


def finish_recording(path: Path) -> bool:
    """Write an unfinished recording again, with all its whole messages, a summary and a footer.

    Returns whether the recording was unfinished. A missing file is none. The recording stays as it
    is if this process ends in between.

    Raises:
        NotWritten: the disk does not take the finished recording.
        ValueError: the file is no recording.
    """
    if not path.is_file() or _is_finished(path):
        return False
    with whole_file(path) as finished:
        _copy(path, finished)
    return True


def _is_finished(path: Path) -> bool:
    """Return whether a file ends as a closed MCAP file does: with its magic again."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)))
        return file.read() == MCAP0_MAGIC


def _copy(path: Path, finished: Path) -> None:
    """Copy all whole messages."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    with finished.open("wb") as copy:
        writer = Writer(copy, use_chunking=False)
        writer.start(profile="", library="concord")
        for record in whole_records(path):
            if isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, Channel):
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id]
                )
            elif isinstance(record, Message):
                writer.add_message(
                    channels[record.channel_id], record.log_time, record.data,
                    record.publish_time, record.sequence,
                )  # fmt: skip
        writer.finish()
