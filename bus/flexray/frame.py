"""The FlexRay frame: what a share is on the wire, byte for byte.

Five bytes of header with an 11-bit CRC, up to 254 bytes of payload, a 24-bit frame CRC (FlexRay
protocol specification 2.1, chapter 4). The polynomials come from the catalogue of CRC algorithms
(CRC-11/FLEXRAY, CRC-24/FLEXRAY-A and -B).
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import anycrc
import msgspec

Channel = Literal["A", "B"]

MAX_PAYLOAD_BYTES = 254
MAX_FRAME_ID = 2047
HEADER_BYTES = 5
TRAILER_BYTES = 3
OVERHEAD_BYTES = HEADER_BYTES + TRAILER_BYTES

_HEADER_CRC = anycrc.Model("CRC11-FLEXRAY")
_FRAME_CRC = {"A": anycrc.Model("CRC24-FLEXRAY-A"), "B": anycrc.Model("CRC24-FLEXRAY-B")}
# A 20-bit CRC register that starts at I equals one that starts at 0 over the same bits with I added
# to the first 11. Four zero bits in front then make whole bytes and change nothing.
_HEADER_CRC_START = 0x01A << 9


class FrameError(ValueError):
    """Bytes that are no frame. `reason` is a short code for counters:

    too-short, length, header-crc, frame-crc, frame-id, startup-indicator.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One frame. `payload` has an even number of bytes, at most 254; `frame_id` is 1..2047."""

    frame_id: int
    cycle_count: int
    payload: bytes
    payload_preamble: bool = False
    null: bool = False
    sync: bool = False
    startup: bool = False


class Inspection(NamedTuple):
    """A frame as its bytes say it is, and whether each checksum agrees."""

    frame: Frame
    header_crc_ok: bool
    frame_crc_ok: bool


def encode(frame: Frame, channel: Channel = "A") -> bytes:
    """The bytes of a frame, header to frame CRC. Raises ValueError for a frame that cannot be."""
    size = len(frame.payload)
    if size > MAX_PAYLOAD_BYTES or size & 1:
        raise ValueError(
            f"a payload of {size} bytes in frame {frame.frame_id}, but FlexRay carries an even "
            f"number of bytes up to {MAX_PAYLOAD_BYTES}; pad or split it (bus.fragments)"
        )
    if not 1 <= frame.frame_id <= MAX_FRAME_ID:
        raise ValueError(f"frame ID {frame.frame_id} is outside of 1..{MAX_FRAME_ID}")
    if not 0 <= frame.cycle_count <= 63:
        raise ValueError(
            f"cycle count {frame.cycle_count} in frame {frame.frame_id} is outside of 0..63; "
            "take the number of the cycle modulo the cluster's number_of_cycles"
        )
    if frame.startup and not frame.sync:
        raise ValueError(
            f"frame {frame.frame_id} has the startup indicator without the sync indicator; "
            "a startup frame is always a sync frame"
        )
    protected = frame.sync << 19 | frame.startup << 18 | frame.frame_id << 7 | size >> 1
    indicators = frame.payload_preamble << 38 | (not frame.null) << 37
    header = indicators | protected << 17 | header_crc(protected) << 6 | frame.cycle_count
    body = header.to_bytes(HEADER_BYTES, "big") + frame.payload
    return body + _FRAME_CRC[channel].calc(body).to_bytes(TRAILER_BYTES, "big")


def decode(data: bytes, channel: Channel = "A") -> Frame:
    """The frame that these bytes are. Raises FrameError, and nothing else, for any bytes."""
    frame, header_crc_ok, frame_crc_ok = inspect(data, channel)
    if not header_crc_ok:
        raise FrameError("header-crc", f"frame {frame.frame_id}: the header CRC does not match")
    if len(frame.payload) != 2 * (data[2] >> 1):
        raise FrameError(
            "length",
            f"frame {frame.frame_id}: the header announces {2 * (data[2] >> 1)} bytes of payload, "
            f"but {len(frame.payload)} came",
        )
    if not frame_crc_ok:
        raise FrameError("frame-crc", f"frame {frame.frame_id}: the frame CRC does not match")
    if frame.frame_id == 0:
        raise FrameError("frame-id", "frame ID 0 is not valid")
    if frame.startup and not frame.sync:
        raise FrameError(
            "startup-indicator", f"frame {frame.frame_id}: a startup frame that is no sync frame"
        )
    return frame


def inspect(data: bytes, channel: Channel = "A") -> Inspection:
    """Return the content of these bytes, right or wrong: for decoders of recordings.

    The payload is all that lies between header and frame CRC, whatever length the header announces.
    Raises FrameError ("too-short") for less than a header and a frame CRC.
    """
    if len(data) < OVERHEAD_BYTES:
        raise FrameError(
            "too-short", f"{len(data)} bytes, but a frame has at least {OVERHEAD_BYTES}"
        )
    frame_id, cycle_count, indicators, header_crc_ok = _read_header(data[:HEADER_BYTES])
    frame = Frame(frame_id, cycle_count, data[HEADER_BYTES:-TRAILER_BYTES], *indicators)
    return Inspection(frame, header_crc_ok, is_intact(data, channel))


def is_intact(data: bytes, channel: Channel = "A") -> bool:
    """Whether the frame CRC of a frame agrees."""
    # The CRC of a message followed by its own CRC is zero.
    return _FRAME_CRC[channel].calc(data) == 0


# Kept, as headers repeat with the cycle counter: a network of 64 nodes has so many.
@lru_cache(4096)
def _read_header(data: bytes) -> tuple[int, int, tuple[bool, bool, bool, bool], bool]:
    """Frame ID, cycle count, the indicators in the order of `Frame`, and whether the CRC agrees."""
    header = int.from_bytes(data, "big")
    protected = header >> 17 & 0xFFFFF
    indicators = (
        bool(header >> 38 & 1),
        not header >> 37 & 1,
        bool(protected >> 19),
        bool(protected >> 18 & 1),
    )
    crc_ok = header_crc(protected) == header >> 6 & 0x7FF
    return protected >> 7 & 0x7FF, header & 0x3F, indicators, crc_ok


@lru_cache(4096)
def header_crc(protected: int) -> int:
    """CRC-11 over the 20 bits sync, startup, frame ID, payload length."""
    return _HEADER_CRC.calc((protected ^ _HEADER_CRC_START).to_bytes(3, "big"), 0)
