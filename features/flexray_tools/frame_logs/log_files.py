"""Logs of frames by their files: captures, tables and BLF; other files are told from them."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from concord.features.flexray_tools.frame_logs.blf_frames import blf_blocks
from concord.features.flexray_tools.frame_logs.captures import capture_blocks, is_capture
from concord.features.flexray_tools.frame_logs.csv_frames import (
    columns_from_file,
    csv_blocks,
    is_frame_table,
)
from concord.features.flexray_tools.frame_logs.frames import FrameBlock, FrameLogError
from concord.features.flexray_tools.recordings.recording_files import CONVERTED

Stamps = Literal["start", "end"]
"""Whether a log has the time of the first or of the last bit of a frame."""
_HEAD_BYTES = 4096
# A clock that counts from the beginning of a measurement, not from 1970.
_LONGEST_MEASUREMENT_NS = 10 * 86_400 * 1_000_000_000


def is_frame_log(path: Path, columns: Path | None = None) -> bool:
    """Return whether a file holds frames, and not the levels of a signal.

    Raises:
        FrameLogError: naming the columns file, if that cannot be read, or the converter of a log
            that concord does not read.
    """
    cure = CONVERTED.get(path.suffix.lower())
    if cure is not None:
        raise FrameLogError(f"{path}: {cure.format(path, path.with_suffix(''))}")
    named = columns_from_file(columns)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False
    if columns is not None or head.startswith(b"LOGG") or is_capture(head):
        return True
    return is_frame_table(head.decode(errors="replace"), named)


class FrameLog:
    """A log of frames, which is read anew by each call of `blocks`.

    Attributes:
        skipped: what the last reading found that is no frame, by its name.
    """

    def __init__(self, path: Path, columns: Path | None = None) -> None:
        self.path = path
        self.skipped: Counter[str] = Counter()
        self._columns = columns_from_file(columns)
        self._origin_ns: int | None = None

    def blocks(self) -> Iterator[FrameBlock]:
        """Yield all frames in the order of the file, a block at a time.

        Times count as in the file; those with a date count from the first frame.

        Raises:
            FrameLogError: naming the file, for one that cannot be read or holds no frame.
        """
        self.skipped = Counter()
        found = False
        try:
            for block in self._read():
                if not len(block.start):
                    continue
                found = True
                if self._origin_ns is None:
                    first = int(block.time_ns[0])
                    self._origin_ns = first if first > _LONGEST_MEASUREMENT_NS else 0
                yield block._replace(time_ns=block.time_ns - self._origin_ns)
        except OSError as error:
            raise FrameLogError(
                f"{self.path}: cannot be read ({error.strerror}); name a log of frames"
            ) from None
        except ValueError as error:
            raise FrameLogError(f"{self.path}: {error}") from None
        if not found:
            there = ", ".join(f"{n} {what}" for what, n in sorted(self.skipped.items()) if n)
            raise FrameLogError(
                f"{self.path}: no frame of FlexRay (link type 210) or CAN (227); the file has "
                f"{there or 'nothing'}; record the bus itself"
            )

    def _read(self) -> Iterator[FrameBlock]:
        with self.path.open("rb") as file:
            head = file.read(4)
            file.seek(0)
            if is_capture(head):
                yield from capture_blocks(file, self.skipped)
                return
        if head == b"LOGG":
            yield from blf_blocks(self.path, self.skipped)
            return
        with self.path.open(encoding="utf-8", errors="replace", newline="") as text:
            yield from csv_blocks(text, self._columns)


def first_frames(log: FrameLog, most: int) -> FrameBlock:
    """Return the first frames of a log, at most so many."""
    taken: list[FrameBlock] = []
    data_bytes = frames = 0
    for block in log.blocks():
        taken.append(block._replace(start=block.start + data_bytes))
        data_bytes, frames = data_bytes + len(block.data), frames + len(block.start)
        if frames >= most:
            break
    columns = [
        np.concatenate(some)[:most] for some in zip(*(one[:-2] for one in taken), strict=True)
    ]
    named: Any = dict(zip(FrameBlock._fields, columns, strict=False))
    return taken[0]._replace(**named, data=b"".join(one.data for one in taken))
