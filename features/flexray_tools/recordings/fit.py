"""Fit a cluster to a recording: slot grid, minislot, macrotick, multiplexing, sync nodes.

Only times within one cycle are used: recordings are known whose gaps between cycles are not true.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.flexray.cluster_parameters import TRAILING_BITS
from concord.features.flexray_tools.recordings.decoder import DecodedFrame, Decoding
from concord.features.flexray_tools.recordings.multiplexing import Multiplex, multiplexing

MACROTICK_RANGE_US = (1.0, 6.0)
# Stations differ in delay and clock by up to half a microsecond on a real bus.
START_TOLERANCE_US = 0.5


class Macrotick(NamedTuple):
    """The macrotick of which static slot and minislot are whole multiples."""

    macrotick_us: float
    static_slot_macroticks: int
    minislot_macroticks: int


class Fit(NamedTuple):
    """The cluster behind a recording; None where the recording does not tell."""

    cycles: tuple[int, ...]
    static_slots: int
    static_slot_us: float | None
    minislot_us: float | None
    macrotick: Macrotick | None
    start_jitter_us: tuple[float, float] | None
    sync_ids: tuple[int, ...]
    startup_ids: tuple[int, ...]
    multiplexing: tuple[Multiplex, ...]
    dynamic_pairs: int
    dynamic_pairs_explained: int


class _Pairs(NamedTuple):
    """Consecutive dynamic frames: time between their starts, the first one's length with the
    shortest trailing sequence, silent IDs, and in which of the cycles."""

    gap_us: NDArray[np.float64]
    frame_us: NDArray[np.float64]
    empty: NDArray[np.float64]
    cycle: NDArray[np.int64]

    def minislots(self, minislot_us: float) -> NDArray[np.float64]:
        """Minislots from start to start: frame rounded up, one for idle, one per silent ID."""
        return np.ceil(self.frame_us / minislot_us) + 1 + self.empty

    def explained(self, minislot_us: float) -> NDArray[np.bool_]:
        misfit = self.gap_us - self.minislots(minislot_us) * minislot_us
        return np.abs(misfit) < START_TOLERANCE_US


def fit(decoding: Decoding) -> Fit:
    """Infer the cluster from the frames whose checksums are right."""
    cycles = tuple(_cycles(decoding))
    static = [[f for f in cycle if decoding.segment(f) == "static"] for cycle in cycles]
    dynamic = [[f for f in cycle if decoding.segment(f) == "dynamic"] for cycle in cycles]
    frames = [frame for cycle in cycles for frame in cycle]
    static_slot_us = _slot_pitch_us(static)
    pairs = _dynamic_pairs(dynamic, TRAILING_BITS / decoding.bit_rate_mbps)
    minislot_us = _minislot_us(pairs)
    explained = 0 if minislot_us is None else int(pairs.explained(minislot_us).sum())
    return Fit(
        cycles=tuple(dict.fromkeys(cycle[0].frame.cycle_count for cycle in cycles)),
        static_slots=decoding.static_slots,
        static_slot_us=static_slot_us,
        minislot_us=minislot_us,
        macrotick=_macrotick(static_slot_us, minislot_us),
        start_jitter_us=_start_jitter_us(static, static_slot_us),
        sync_ids=tuple(sorted({f.frame.frame_id for f in frames if f.frame.sync})),
        startup_ids=tuple(sorted({f.frame.frame_id for f in frames if f.frame.startup})),
        multiplexing=multiplexing(cycles, decoding.static_slots),
        dynamic_pairs=len(pairs.gap_us),
        dynamic_pairs_explained=explained,
    )


def _cycles(decoding: Decoding) -> Iterator[list[DecodedFrame]]:
    """Runs of correct frames of one communication cycle."""
    run: list[DecodedFrame] = []
    for decoded in decoding.frames:
        if not (decoded.header_crc_ok and decoded.frame_crc_ok):
            continue
        last = run[-1].frame if run else decoded.frame
        same = last.cycle_count == decoded.frame.cycle_count
        if run and not (same and last.frame_id < decoded.frame.frame_id):
            yield run
            run = []
        run.append(decoded)
    if run:
        yield run


def _slot_pitch_us(static: Sequence[Sequence[DecodedFrame]]) -> float | None:
    """Median slope of start over frame ID, over all pairs within a cycle (Theil and Sen)."""
    slopes = [
        (later.start_us - earlier.start_us) / (later.frame.frame_id - earlier.frame.frame_id)
        for cycle in static
        for place, earlier in enumerate(cycle)
        for later in cycle[place + 1 :]
    ]
    return float(np.median(slopes)) if slopes else None


def _start_jitter_us(
    static: Sequence[Sequence[DecodedFrame]], pitch_us: float | None
) -> tuple[float, float] | None:
    """Earliest and latest start of a static frame against the middle of its cycle's grid."""
    if pitch_us is None:
        return None
    offsets = [
        np.array([f.start_us - f.frame.frame_id * pitch_us for f in cycle])
        for cycle in static
        if cycle
    ]
    centred = np.concatenate([offset - np.median(offset) for offset in offsets])
    return float(centred.min()), float(centred.max())


def _dynamic_pairs(dynamic: Sequence[Sequence[DecodedFrame]], trailing_us: float) -> _Pairs:
    pairs = [(i, a, b) for i, cycle in enumerate(dynamic) for a, b in pairwise(cycle)]
    return _Pairs(
        gap_us=np.array([b.start_us - a.start_us for _, a, b in pairs], dtype=float),
        frame_us=np.array([a.end_us - a.start_us + trailing_us for _, a, _ in pairs], dtype=float),
        empty=np.array([b.frame.frame_id - a.frame.frame_id - 1 for _, a, b in pairs], dtype=float),
        cycle=np.array([i for i, _, _ in pairs], dtype=int),
    )


def _minislot_us(pairs: _Pairs) -> float | None:
    """The minislot length that explains the most pairs, refined by least squares over whole cycles.

    A segment of a hundred minislots averages out what stations differ in delay.
    """
    if not len(pairs.gap_us):
        return None
    candidates = np.arange(2.0, 63 * MACROTICK_RANGE_US[1], 0.01)
    counts = np.array([pairs.explained(candidate).sum() for candidate in candidates])
    best = candidates[counts == counts.max()]
    minislot_us = float(np.median(best[best <= best[0] + 1.0]))
    kept = pairs.explained(minislot_us)
    if not kept.any():
        return None
    minislots = np.bincount(pairs.cycle[kept], pairs.minislots(minislot_us)[kept])
    time_us = np.bincount(pairs.cycle[kept], pairs.gap_us[kept])
    return float(minislots @ time_us / (minislots @ minislots))


def _macrotick(static_slot_us: float | None, minislot_us: float | None) -> Macrotick | None:
    """The macrotick (1..6 us) that divides both best; the longest of equally good ones."""
    if static_slot_us is None or minislot_us is None:
        return None
    shortest, longest = MACROTICK_RANGE_US
    counts = np.arange(np.ceil(static_slot_us / longest), np.floor(static_slot_us / shortest) + 1)
    macroticks = static_slot_us / counts
    minislots = np.maximum(np.round(minislot_us / macroticks), 1)
    misfit = np.abs(minislots * macroticks - minislot_us)
    if not len(counts) or misfit.min() > START_TOLERANCE_US:
        return None
    best = int(np.argmax(misfit <= misfit.min() + 1e-3))
    return Macrotick(float(macroticks[best]), int(counts[best]), int(minislots[best]))
