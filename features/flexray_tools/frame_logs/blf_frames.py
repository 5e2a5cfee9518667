"""Frames of a BLF file, the binary log of Vector's tools, by the package `vblf` (extra `logs`).

The flags of a frame are those of `VBLFlexRayVFrReceiveMsgEx`: 1 null, 4 sync, 8 startup, 16 payload
preamble, 64 error.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from concord.features.flexray_tools.frame_logs.frames import (
    BAD_FRAME,
    BLOCK_FRAMES,
    NULL,
    PREAMBLE,
    STARTUP,
    SYNC,
    FrameBlock,
    FrameLogError,
)

_FLAGS = {1: NULL, 4: SYNC, 8: STARTUP, 16: PREAMBLE, 64: BAD_FRAME}
_TEN_MICROSECONDS = 1
_CHANNEL_B, _BOTH = 2, 3
_Received = tuple[int, int, int, int, int, bytes]


def blf_blocks(path: Path, skipped: Counter[str]) -> Iterator[FrameBlock]:
    """Yield the frames of FlexRay of a BLF file.

    Raises:
        FrameLogError: the extra is missing, or the file is no BLF file.
    """
    try:
        from vblf.flexray import FlexrayVFrReceiveMsgEx
        from vblf.reader import BlfReader
    except ImportError:
        raise FrameLogError(
            "BLF files need the package vblf (make extras); or export the frames as CSV or pcapng"
        ) from None
    rows: list[_Received] = []
    try:
        with path.open("rb") as file:
            for one in BlfReader(file):
                if not isinstance(one, FlexrayVFrReceiveMsgEx):
                    skipped["objects that are no frame of FlexRay"] += 1
                    continue
                rows += _rows(one)
                if len(rows) >= BLOCK_FRAMES:
                    yield _block(rows)
                    rows = []
    except (ValueError, OSError, EOFError) as error:
        raise FrameLogError(f"is no BLF file that can be read ({error}); record it anew") from None
    if rows:
        yield _block(rows)


def _rows(one: Any) -> Iterator[_Received]:
    """Yield a received frame on each of its channels."""
    unit_ns = 10_000 if one.header.object_flags & _TEN_MICROSECONDS else 1
    flags = sum(bit for theirs, bit in _FLAGS.items() if one.frame_flags & theirs)
    payload = bytes(one.data_bytes[: one.byte_count])
    time_ns = one.header.object_time_stamp * unit_ns
    for channel in {_CHANNEL_B: (1,), _BOTH: (0, 1)}.get(one.channel_mask, (0,)):
        yield time_ns, channel, one.frame_id & 0x7FF, one.cycle & 0x3F, flags, payload


def _block(rows: list[_Received]) -> FrameBlock:
    times, channels, ids, cycles, flags, payloads = zip(*rows, strict=True)
    lengths = np.array([len(one) for one in payloads], dtype=np.int64)
    return FrameBlock(
        np.array(times, dtype=np.int64),
        np.array(channels, dtype=np.uint8),
        np.array(ids, dtype=np.int64),
        np.array(cycles, dtype=np.uint8),
        np.array(flags, dtype=np.uint8),
        np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64),
        lengths,
        b"".join(payloads),
    )
