"""Counts over a log of frames, in memory that does not grow with its length."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.flexray.frame import OVERHEAD_BYTES
from concord.features.flexray_tools.frame_logs.frames import (
    BAD_FRAME,
    BAD_HEADER,
    NULL,
    STARTUP,
    SYNC,
    BusKind,
    FrameBlock,
    FrameLogError,
)

COUNTERS = 64
_ID_BITS = 29
_ROWS = 256
_START_BITS, _END_BITS, _CODED_BITS = 10, 2, 10
_Counts = NDArray[np.int64]


class _Columns(NamedTuple):
    """Row of the tally, cycle counter, time and flags of frames, (n,) each."""

    row: _Counts
    cycle: _Counts
    time_ns: _Counts
    flags: _Counts

    def part(self, first: int | None, last: int | None) -> "_Columns":
        return _Columns(*(one[first:last] for one in self))


class _CycleCounts:
    """In how many cycles of each counter (R, 64) a frame came, and carried data, and how many such
    cycles there are (64,)."""

    def __init__(self) -> None:
        self.seen = np.zeros((_ROWS, COUNTERS), dtype=np.int64)
        self.data = np.zeros((_ROWS, COUNTERS), dtype=np.int64)
        self.recorded = np.zeros(COUNTERS, dtype=np.int64)

    def add(self, some: _Columns, rows: int) -> None:
        if rows > len(self.seen):
            self.seen = _grown(self.seen, rows)
            self.data = _grown(self.data, rows)
        place = some.row * COUNTERS + some.cycle
        self.seen += _counted(place, self.seen.shape)
        self.data += _counted(place[some.flags & NULL == 0], self.seen.shape)
        begins = np.append(True, some.cycle[1:] != some.cycle[:-1])[: len(some.cycle)]
        self.recorded += np.bincount(some.cycle[begins], minlength=COUNTERS)


def _counted(place: _Counts, shape: tuple[int, ...]) -> _Counts:
    return np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape)


def _grown(counts: _Counts, rows: int) -> _Counts:
    more = np.zeros((2 * rows - len(counts), *counts.shape[1:]), dtype=counts.dtype)
    return np.concatenate((counts, more))


class FrameStatistics(NamedTuple):
    """One frame ID on one channel.

    Attributes:
        channel: 0 for A, 1 for B.
        frames: with right checksums; `null` of them are null frames.
        payload_bytes: shortest and longest payload of frames with data; without such, the longest
            of null frames.
        flags: indicators that some frame had.
        seen, data: (64,) cycles of each counter in which it came, and carried data.
        lost: frames that are missing in whole cycles of the counters in which it comes; counted for
            a static slot, which sends in each of its cycles.
        gap_us: shortest, mean and longest time between two; None for less than two.
        jitter_us: earliest and latest, against a whole number of cycles after the frame before;
            None where the length of a cycle is unknown.
    """

    channel: int
    frame_id: int
    frames: int
    null: int
    payload_bytes: tuple[int, int]
    flags: int
    seen: _Counts
    data: _Counts
    lost: int
    gap_us: tuple[float, float, float] | None
    jitter_us: tuple[float, float] | None


class LogTally(NamedTuple):
    """A whole log. `recorded` (64,) are the cycles of each counter in which any frame came, `lost`
    the cycles without any; `bits` (2,) were on the wire of each channel."""

    kind: BusKind
    frames: int
    header_wrong: int
    frame_wrong: int
    span_us: float
    cycle_us: float | None
    recorded: _Counts
    lost_cycles: int
    bits: _Counts
    rows: tuple[FrameStatistics, ...]


class GrowingTally:
    """Counts of a log that grow by its blocks."""

    def __init__(self, cycle_us: float | None, counters: int) -> None:
        self._cycle_ns = None if cycle_us is None else cycle_us * 1e3
        self._counters = counters
        self._of_key: dict[int, int] = {}
        self._keys = np.zeros(_ROWS, dtype=np.int64)
        self._frames = np.zeros((_ROWS, 2), dtype=np.int64)
        self._lengths = np.tile(np.array([[1 << 30, -1]]), (_ROWS, 1))
        self._null_bytes = np.zeros(_ROWS, dtype=np.int64)
        self._flags = np.zeros(_ROWS, dtype=np.int64)
        self._last_ns = np.full(_ROWS, -1, dtype=np.int64)
        self._gaps = np.tile(np.array([[np.inf, 0.0, -np.inf, 0.0]]), (_ROWS, 1))
        self._jitter = np.tile(np.array([[np.inf, -np.inf]]), (_ROWS, 1))
        self._first, self._inner, self._last = _CycleCounts(), _CycleCounts(), _CycleCounts()
        self._tail: _Columns | None = None
        self._began = False
        self._frames_in_all = self._header_wrong = self._frame_wrong = 0
        self._bits = np.zeros(2, dtype=np.int64)
        self._span: tuple[int, int] | None = None
        self._lost_cycles = 0
        self._kind: BusKind = "flexray"

    def add(self, block: FrameBlock) -> None:
        """Count the frames of a block; those with a wrong checksum count as wrong alone."""
        self._kind = block.kind
        self._frames_in_all += len(block.flags)
        self._header_wrong += int(np.count_nonzero(block.flags & BAD_HEADER))
        self._frame_wrong += int(np.count_nonzero(block.flags & BAD_FRAME))
        first, _ = self._span or (int(block.time_ns[0]), 0)
        self._span = first, int(block.time_ns[-1])
        bits = _START_BITS + _END_BITS + _CODED_BITS * (block.length + OVERHEAD_BYTES)
        self._bits += np.bincount(block.channel, bits, 2).astype(np.int64)
        sure = block.sure
        if not sure.all():
            block = block.of(sure)
        if not len(block.flags):
            return
        rows = self._rows(block)
        some = _Columns(
            rows, block.cycle.astype(np.int64), block.time_ns, block.flags.astype(np.int64)
        )
        self._add_frames(some, block.length)
        self._add_times(some)
        if block.kind == "flexray":
            self._add_cycles(some)

    def _rows(self, block: FrameBlock) -> _Counts:
        keys = block.channel.astype(np.int64) << _ID_BITS | block.frame_id
        unique, inverse = np.unique(keys, return_inverse=True)
        known = self._of_key
        places = [known.setdefault(key, len(known)) for key in unique.tolist()]
        if len(known) > len(self._keys):
            self._grow(len(known))
        self._keys[places] = unique
        return np.array(places, dtype=np.int64)[inverse]

    def _grow(self, rows: int) -> None:
        def grown(values: np.ndarray) -> np.ndarray:
            return np.concatenate((values, np.repeat(values[-1:], 2 * rows - len(values), axis=0)))

        # The last row of each array is empty still.
        rows += 1
        self._keys, self._frames, self._lengths = map(
            grown, (self._keys, self._frames, self._lengths)
        )
        self._null_bytes = grown(self._null_bytes)
        self._flags, self._last_ns = grown(self._flags), grown(self._last_ns)
        self._gaps, self._jitter = grown(self._gaps), grown(self._jitter)

    def _add_frames(self, some: _Columns, length: _Counts) -> None:
        null = some.flags & NULL != 0
        rows = len(self._keys)
        self._frames[:, 0] += np.bincount(some.row, minlength=rows)
        self._frames[:, 1] += np.bincount(some.row[null], minlength=rows)
        np.minimum.at(self._lengths[:, 0], some.row[~null], length[~null])
        np.maximum.at(self._lengths[:, 1], some.row[~null], length[~null])
        np.maximum.at(self._null_bytes, some.row[null], length[null])
        np.bitwise_or.at(self._flags, some.row, some.flags)

    def _add_times(self, some: _Columns) -> None:
        """Count gaps between the frames of each row; those before the block are known."""
        order = np.argsort(some.row, kind="stable")
        rows, times = some.row[order], some.time_ns[order]
        new = np.append(True, rows[1:] != rows[:-1])
        before = np.append(0, times[:-1])
        before[new] = self._last_ns[rows[new]]
        self._last_ns[rows[np.append(new[1:], True)]] = times[np.append(new[1:], True)]
        known = before >= 0
        rows, gap = rows[known], (times - before)[known].astype(float)
        count = len(self._keys)
        np.minimum.at(self._gaps[:, 0], rows, gap)
        np.maximum.at(self._gaps[:, 2], rows, gap)
        self._gaps[:, 1] += np.bincount(rows, gap, count)
        self._gaps[:, 3] += np.bincount(rows, minlength=count)
        if self._cycle_ns is not None:
            misfit = gap - np.round(gap / self._cycle_ns) * self._cycle_ns
            np.minimum.at(self._jitter[:, 0], rows, misfit)
            np.maximum.at(self._jitter[:, 1], rows, misfit)

    def _add_cycles(self, some: _Columns) -> None:
        """Count by whole cycles: the last one of the block waits for the next block."""
        if self._tail is not None:
            some = _Columns(*map(np.concatenate, zip(self._tail, some, strict=True)))
        ends = np.flatnonzero(some.cycle[1:] != some.cycle[:-1]) + 1
        if not len(ends):
            self._tail = some
            return
        begin, last, rows = 0, int(ends[-1]), len(self._keys)
        if not self._began:
            begin, self._began = int(ends[0]), True
            self._first.add(some.part(None, begin), rows)
        self._lost_cycles += self._missing(some, ends)
        if last > begin:
            self._inner.add(some.part(begin, last), rows)
        self._tail = some.part(last, None)

    def _missing(self, some: _Columns, ends: _Counts) -> int:
        """Return how many cycles are missing between consecutive ones."""
        passed = (some.cycle[ends] - some.cycle[ends - 1]) % self._counters
        if self._cycle_ns is not None:
            begins = np.append(0, ends[:-1])
            cycles = (some.time_ns[ends] - some.time_ns[begins]) / self._cycle_ns
            passed += self._counters * np.round((cycles - passed) / self._counters).astype(int)
        return int(np.maximum(passed - 1, 0).sum())

    def result(self) -> LogTally:
        """Return the counts of all blocks. Call it once, at the end."""
        rows = len(self._keys)
        if self._tail is not None:
            self._last.add(self._tail, rows)
        parts = self._first, self._inner, self._last
        for one in parts:
            one.seen, one.data = (_grown(x, rows)[:rows] for x in (one.seen, one.data))
        seen, data = sum(one.seen for one in parts), sum(one.data for one in parts)
        expected = np.where(np.asarray(seen) > 0, self._inner.recorded, 0)
        lost = (expected - self._inner.seen).sum(axis=1)
        first, last = self._span or (0, 0)
        return LogTally(
            kind=self._kind,
            frames=self._frames_in_all,
            header_wrong=self._header_wrong,
            frame_wrong=self._frame_wrong,
            span_us=(last - first) / 1e3,
            cycle_us=None if self._cycle_ns is None else self._cycle_ns / 1e3,
            recorded=np.asarray(sum(one.recorded for one in parts)),
            lost_cycles=self._lost_cycles,
            bits=self._bits,
            rows=tuple(
                self._statistics(row, np.asarray(seen)[row], np.asarray(data)[row], int(lost[row]))
                for _, row in sorted(self._of_key.items())
            ),
        )

    def _statistics(self, row: int, seen: _Counts, data: _Counts, lost: int) -> FrameStatistics:
        key, (frames, null) = int(self._keys[row]), self._frames[row].tolist()
        shortest, total, longest, gaps = self._gaps[row].tolist()
        shortest_bytes, longest_bytes = self._lengths[row].tolist()
        null_bytes = int(self._null_bytes[row]), int(self._null_bytes[row])
        knows_jitter = gaps and self._cycle_ns is not None
        earliest, latest = self._jitter[row].tolist()
        return FrameStatistics(
            channel=key >> _ID_BITS,
            frame_id=key & (1 << _ID_BITS) - 1,
            frames=frames,
            null=null,
            payload_bytes=(shortest_bytes, longest_bytes) if longest_bytes >= 0 else null_bytes,
            flags=int(self._flags[row]),
            seen=seen,
            data=data,
            lost=lost,
            gap_us=(shortest / 1e3, total / gaps / 1e3, longest / 1e3) if gaps else None,
            jitter_us=(earliest / 1e3, latest / 1e3) if knows_jitter else None,
        )


def tallied(blocks: Iterable[FrameBlock], sample: FrameBlock) -> LogTally:
    """Return the counts of a log; its first frames tell the length of a cycle."""
    tally = GrowingTally(cycle_us_of(sample), int(sample.cycle.max()) + 1)
    for block in blocks:
        tally.add(block)
    return tally.result()


def cycle_us_of(sample: FrameBlock) -> float | None:
    """Return the middle time between frames of one ID in consecutive cycles; None without such."""
    if sample.kind != "flexray":
        return None
    sample = sample.of(sample.sure)
    key = sample.channel.astype(np.int64) << _ID_BITS | sample.frame_id
    order = np.argsort(key, kind="stable")
    key, cycle, time_ns = key[order], sample.cycle[order].astype(int), sample.time_ns[order]
    next_one = (key[1:] == key[:-1]) & (np.diff(cycle) == 1)
    gaps_ns = np.diff(time_ns)[next_one]
    return float(np.median(gaps_ns)) / 1e3 if len(gaps_ns) and np.median(gaps_ns) > 0 else None


def static_border(tally: LogTally, sample: FrameBlock) -> int:
    """Return the highest ID of the static segment; 0 for a log of dynamic frames alone.

    Sync and null frames are static. All static frames have one payload length, and begin on a grid
    that the ID counts.
    """
    if tally.kind != "flexray":
        raise FrameLogError(
            "the frames are of CAN, which has no cycles and no slots; `concord flexray decode` and "
            "`statistics` read them"
        )
    marked = [one.frame_id for one in tally.rows if one.flags & (NULL | SYNC | STARTUP)]
    sure = max(marked, default=0)
    lengths: dict[int, set[int]] = {}
    for one in tally.rows:
        if one.frames > one.null:
            lengths.setdefault(one.frame_id, set()).update(one.payload_bytes)
    static_lengths: set[int] = set()
    border, ids = sure, sorted(lengths)
    for frame_id in ids:
        static_lengths |= lengths[frame_id]
        if frame_id > sure:
            if len(static_lengths) > 1:
                break
            border = frame_id
    return max(sure, _on_grid(sample, sure, border))


def _on_grid(sample: FrameBlock, sure: int, border: int) -> int:
    """Return the highest ID up to `border` before the first one that leaves the grid of slots."""
    some = sample.of(sample.sure & (sample.frame_id <= border))
    if len(some.flags) < 2:
        return border
    begins = np.append(True, some.cycle[1:] != some.cycle[:-1])
    cycle = np.cumsum(begins)
    step = (np.diff(cycle) == 0) & (np.diff(some.frame_id) > 0)
    slopes = np.diff(some.time_ns)[step] / np.diff(some.frame_id)[step]
    if not len(slopes):
        return border
    pitch_ns = float(np.median(slopes))
    offset = some.time_ns - some.frame_id * pitch_ns
    # The first frame of a cycle is static where any is.
    misfit = np.abs(offset - offset[begins][cycle - 1])
    for frame_id in np.unique(some.frame_id).tolist():
        ours = misfit[some.frame_id == frame_id]
        if frame_id > sure and np.median(ours) > _GRID_TOLERANCE_NS:
            return max(0, frame_id - 1) if frame_id > 1 else 0
    return border


_GRID_TOLERANCE_NS = 2500.0
