"""Frames of a CSV table: a line for each frame, with time, ID, cycle and payload.

The names of the columns are those of `FrameColumns`, or what a columns file gives in their place:

    frame_id = "Slot"
    time = { column = "Time", unit = "ms" }
"""

import csv
import re
import tomllib
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO

import msgspec
import numpy as np

from concord.features.flexray_tools.frame_logs.frames import (
    BAD_FRAME,
    BAD_HEADER,
    BLOCK_FRAMES,
    NULL,
    PREAMBLE,
    STARTUP,
    SYNC,
    FrameBlock,
    FrameLogError,
)
from concord.features.flexray_tools.recordings.csv_recording import NANOSECONDS, Unit

_TIME = re.compile(r"time[ _]?[(\[]?(ns|us|ms|s)?[)\]]?", re.IGNORECASE)
_MOST_ID, _MOST_CYCLE, _MOST_PAYLOAD_BYTES = 2**29 - 1, 63, 254
_FLAGS = {"null": NULL, "sync": SYNC, "startup": STARTUP, "payload_preamble": PREAMBLE}
_CHECKS = {"header_crc_ok": BAD_HEADER, "frame_crc_ok": BAD_FRAME}
_TRUE, _FALSE = {"1", "true", "yes", "x"}, {"0", "false", "no", ""}


class TimeColumn(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Column of the times, and their unit."""

    column: str
    unit: Unit = "s"


class FrameColumns(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which column of a table is what; a column that the table lacks takes its usual value.

    The channel is A, all checksums are right, and no indicator is set. Without `cycle` the frames
    are those of a bus without cycles. IDs and cycles may be hexadecimal (0x1F), payloads are.
    """

    time: TimeColumn | None = None
    channel: str = "channel"
    frame_id: str = "frame_id"
    cycle: str = "cycle"
    payload: str = "payload"
    null: str = "null"
    sync: str = "sync"
    startup: str = "startup"
    payload_preamble: str = "payload_preamble"
    header_crc_ok: str = "header_crc_ok"
    frame_crc_ok: str = "frame_crc_ok"


def columns_from_file(path: Path | None) -> FrameColumns:
    """Read a columns file; without one the columns have their usual names.

    Raises:
        FrameLogError: naming the file, which cannot be read or has another field.
    """
    if path is None:
        return FrameColumns()
    try:
        return msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), FrameColumns)
    except OSError as error:
        raise FrameLogError(f"{path}: cannot be read ({error.strerror}); name a file") from None
    except (tomllib.TOMLDecodeError, UnicodeError, msgspec.ValidationError) as error:
        raise FrameLogError(f"{path}: is no columns file: {error}") from None


class _Table:
    """Places of the columns in a line, and the unit of the times."""

    def __init__(self, heading: Sequence[str], columns: FrameColumns) -> None:
        self._place = {name.strip().strip('"'): place for place, name in enumerate(heading)}
        self._columns = columns
        self.time, self.scale_ns = self._time()
        for field in ("frame_id", "payload"):
            if getattr(columns, field) not in self._place:
                raise FrameLogError(self._missing(field, getattr(columns, field)))

    def _missing(self, field: str, name: str) -> str:
        return (
            f"no column {name!r} for {field}; the table has {', '.join(self._place)}; name it in a "
            f'columns file: {field} = "..." (--columns FILE.toml)'
        )

    def _time(self) -> tuple[int, float]:
        stated = self._columns.time
        if stated is not None:
            if stated.column not in self._place:
                raise FrameLogError(self._missing("time", stated.column))
            return self._place[stated.column], NANOSECONDS[stated.unit]
        for name, place in self._place.items():
            if match := _TIME.fullmatch(name.strip()):
                return place, NANOSECONDS[(match[1] or "s").lower()]
        raise FrameLogError(
            f"no column of times among {', '.join(self._place)}; call it time_s, time_ms, time_us "
            'or time_ns, or name it in a columns file: time = { column = "...", unit = "s" }'
        )

    def place(self, field: str) -> int | None:
        """Return the place of a column in a line; None for one that the table lacks."""
        return self._place.get(getattr(self._columns, field))


def is_frame_table(head: str, columns: FrameColumns) -> bool:
    """Return whether the heading of CSV text is that of frames, not of levels."""
    lines = [one for one in head.splitlines() if one.strip() and one[0] not in ";#"]
    names = re.split("[,;\t]", lines[0]) if lines else []
    there = {name.strip().strip('"') for name in names}
    return columns.frame_id in there and columns.payload in there


def csv_blocks(file: TextIO, columns: FrameColumns) -> Iterator[FrameBlock]:
    """Yield the frames of a table.

    Raises:
        FrameLogError: a column is missing, or a line holds what is no frame, with its number.
    """
    numbered = ((n, line) for n, line in enumerate(file, 1) if line.strip() and line[0] not in ";#")
    _, heading = next(numbered)
    separator = max(",;\t", key=heading.count)
    table = _Table(next(csv.reader([heading], delimiter=separator)), columns)
    while some := list(islice(numbered, BLOCK_FRAMES)):
        rows = list(csv.reader((line for _, line in some), delimiter=separator))
        try:
            yield _block(rows, table)
        except (ValueError, IndexError):
            # Slow, but it tells the line.
            for (number, _), row in zip(some, rows, strict=True):
                try:
                    _block([row], table)
                except (ValueError, IndexError) as error:
                    raise FrameLogError(f"line {number}: {error}; correct it") from None
            raise


def _block(rows: Sequence[Sequence[str]], table: _Table) -> FrameBlock:
    count = len(rows)

    def column(field: str) -> list[str] | None:
        place = table.place(field)
        return None if place is None else [row[place].strip() for row in rows]

    times = [row[table.time] for row in rows]
    # A date in nanoseconds has more digits than a float.
    time_ns = np.array(
        [int(one) if table.scale_ns == 1 and one.isdecimal() else _nanoseconds(one, table.scale_ns)
         for one in times], dtype=np.int64,
    )  # fmt: skip
    ids, cycles = column("frame_id"), column("cycle")
    payloads = [_payload(one) for one in column("payload") or ()]
    lengths = np.array([len(one) for one in payloads], dtype=np.int64)
    flags = np.zeros(count, dtype=np.uint8)
    for field, bit in (_FLAGS | _CHECKS).items():
        values = column(field)
        if values is not None:
            set_for = [_truth(field, one) != (field in _CHECKS) for one in values]
            flags |= np.where(set_for, bit, 0).astype(np.uint8)
    channels = column("channel")
    return FrameBlock(
        time_ns,
        np.zeros(count, np.uint8) if channels is None else _channels(channels),
        _numbers("frame_id", ids or (), _MOST_ID),
        np.zeros(count, np.uint8)
        if cycles is None
        else _numbers("cycle", cycles, _MOST_CYCLE).astype(np.uint8),
        flags,
        np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64),
        lengths,
        b"".join(payloads),
        "can" if cycles is None else "flexray",
    )


def _nanoseconds(text: str, scale_ns: float) -> int:
    try:
        return round(float(text) * scale_ns)
    except (ValueError, OverflowError):
        raise ValueError(f"the time is {text!r}, and must be a number") from None


def _payload(text: str) -> bytes:
    try:
        payload = bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        raise ValueError(f"the payload {text[:20]!r} is not hexadecimal") from None
    if len(payload) > _MOST_PAYLOAD_BYTES:
        raise ValueError(
            f"the payload has {len(payload)} bytes, and a frame {_MOST_PAYLOAD_BYTES} at most"
        )
    return payload


def _numbers(field: str, texts: Sequence[str], most: int) -> np.ndarray:
    try:
        values = np.array([int(one, 16 if "x" in one else 10) for one in texts], dtype=np.int64)
    except ValueError:
        raise ValueError(f"{field} is {texts[0]!r}, and must be a whole number") from None
    if len(values) and not (values.min() >= 0 and values.max() <= most):
        raise ValueError(f"{field} is {values.max()}, and must be 0 to {most}")
    return values


def _truth(field: str, text: str) -> bool:
    lowered = text.lower()
    if lowered not in _TRUE | _FALSE:
        raise ValueError(f"{field} is {text!r}, and must be 0 or 1")
    return lowered in _TRUE


def _channels(texts: Sequence[str]) -> np.ndarray:
    wrong = set(texts) - {"A", "B", "0", "1", "a", "b"}
    if wrong:
        raise ValueError(f"channel is {min(wrong)!r}, and must be A or B")
    return np.array([one in "Bb1" for one in texts], dtype=np.uint8)
