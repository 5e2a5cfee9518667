"""Frames of a log as columns, a block of them at a time, so that a long log needs little memory."""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from concord.bus.flexray.frame import Channel, Frame, header_crc

NULL, SYNC, STARTUP, PREAMBLE, BAD_HEADER, BAD_FRAME = 1, 2, 4, 8, 16, 32
"""Bits of the column `flags`."""
BLOCK_FRAMES = 65_536
"""About as many frames are read at a time."""
BusKind = Literal["flexray", "can"]
_HALF_BITS = 10


class FrameLogError(ValueError):
    """A log of frames that cannot be read."""


class FrameBlock(NamedTuple):
    """Some consecutive frames of a log; all columns have n entries.

    Attributes:
        time_ns: (n,) int64, as the file has it.
        channel: (n,) 0 for A, 1 for B.
        frame_id: (n,) slot of FlexRay, identifier of CAN.
        cycle: (n,) cycle counter; 0 on a bus without one.
        flags: (n,) sums of NULL, SYNC, STARTUP, PREAMBLE, BAD_HEADER and BAD_FRAME.
        start, length: (n,) place and bytes of each payload in `data`.
        data: payloads, and what lies between them.
        kind: of the bus.
    """

    time_ns: NDArray[np.int64]
    channel: NDArray[np.uint8]
    frame_id: NDArray[np.int64]
    cycle: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    start: NDArray[np.int64]
    length: NDArray[np.int64]
    data: bytes
    kind: BusKind = "flexray"

    @property
    def sure(self) -> NDArray[np.bool_]:
        """(n,) Whether both checksums of a frame agree."""
        return self.flags & (BAD_HEADER | BAD_FRAME) == 0

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """Return these frames alone."""
        columns: Any = [one[chosen] if isinstance(one, np.ndarray) else one for one in self]
        return type(self)(*columns)

    def rows(self) -> Iterator[tuple[int, int, int, int, int, bytes]]:
        """Yield time in nanoseconds, channel, ID, cycle, flags and payload of each frame."""
        columns = (
            self.time_ns, self.channel, self.frame_id, self.cycle, self.flags, self.start,
            self.start + self.length,
        )  # fmt: skip
        data = self.data
        for *row, first, last in zip(*(one.tolist() for one in columns), strict=True):
            time_ns, channel, frame_id, cycle, flags = row
            yield time_ns, channel, frame_id, cycle, flags, data[first:last]


def frame_of(frame_id: int, cycle: int, flags: int, payload: bytes) -> Frame:
    """Return a row of a block as a frame of FlexRay."""
    return Frame(
        frame_id=frame_id,
        cycle_count=cycle,
        payload=payload,
        payload_preamble=bool(flags & PREAMBLE),
        null=bool(flags & NULL),
        sync=bool(flags & SYNC),
        startup=bool(flags & STARTUP),
    )


def channel_name(number: int) -> Channel:
    """Return the name of channel 0 or 1."""
    return "B" if number else "A"


def header_crcs(protected: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the header CRCs (n,) of the 20 protected bits of headers.

    A CRC is linear: that of a number follows from those of its upper and lower half.
    """
    upper, lower = np.divmod(protected, 1 << _HALF_BITS)
    return _UPPER[upper] ^ _LOWER[lower]


_HALVES = range(1 << _HALF_BITS)
_UPPER = np.array([header_crc(half << _HALF_BITS) for half in _HALVES], dtype=np.int64)
_LOWER = np.array([header_crc(half) ^ header_crc(0) for half in _HALVES], dtype=np.int64)


def from_headers(
    headers: NDArray[np.uint8], errors: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int64]]:
    """Return frame IDs, cycles, flags and announced payload bytes (n,) of headers (n, 5).

    `errors` (n,) are the flags BAD_HEADER and BAD_FRAME that are known; a header CRC that
    disagrees adds BAD_HEADER.
    """
    words = headers.astype(np.int64)
    word = words[:, 0] << 32 | words[:, 1] << 24 | words[:, 2] << 16 | words[:, 3] << 8
    word |= words[:, 4]
    protected = word >> 17 & 0xFFFFF
    flags = errors.astype(np.int64)
    flags |= np.where(header_crcs(protected) == word >> 6 & 0x7FF, 0, BAD_HEADER)
    flags |= np.where(word >> 37 & 1, 0, NULL)
    flags |= np.where(word >> 38 & 1, PREAMBLE, 0)
    flags |= np.where(protected >> 19 & 1, SYNC, 0)
    flags |= np.where(protected >> 18 & 1, STARTUP, 0)
    ids, lengths = protected >> 7 & 0x7FF, 2 * (protected & 0x7F)
    return ids, (word & 0x3F).astype(np.uint8), flags.astype(np.uint8), lengths
