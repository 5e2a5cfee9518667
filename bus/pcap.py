"""Frames as a capture file that Wireshark opens: pcap with link type 210 (FlexRay).

Each packet of a frame is a measurement header (channel, type), a byte of error flags, then header
and payload; the frame CRC is not stored, but the flags say whether it was right. A symbol is a
measurement header and the number of its low bits.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from concord.bus.bus import Captured, Link, file_header, timed
from concord.bus.flexray.frame import OVERHEAD_BYTES, TRAILER_BYTES, inspect

LINK_TYPE_FLEXRAY = 210
_TYPE_FRAME = 0x01
_TYPE_SYMBOL = 0x02
_MOST_SYMBOL_BITS = 127
_CHANNEL_B = 0x80
_FRAME_CRC_ERROR = 0x10
_HEADER_CRC_ERROR = 0x08
_CODING_ERROR = 0x02


class CapturedSymbol(NamedTuple):
    """Low bits of a symbol on the bus and when they began."""

    time_us: float
    low_bits: int
    channel: str = "A"


def packet(captured: Captured | CapturedSymbol) -> bytes:
    """One frame or symbol as a packet of a capture file of FlexRay."""
    if isinstance(captured, Captured):
        return timed(captured.time_us, _frame_body(captured))
    channel = _CHANNEL_B if captured.channel == "B" else 0
    body = bytes((_TYPE_SYMBOL | channel, min(captured.low_bits, _MOST_SYMBOL_BITS)))
    return timed(captured.time_us, body)


def _frame_body(captured: Captured) -> bytes:
    """Return a measurement header, error flags and a frame; those of a collision have the coding
    error flag.

    Fewer bytes than any frame has are stored as they are, with the coding error flag.
    """
    data = captured.data
    measurement = _TYPE_FRAME | (_CHANNEL_B if captured.channel == "B" else 0)
    if len(data) < OVERHEAD_BYTES:
        return bytes((measurement, _CODING_ERROR)) + data
    _, header_crc_ok, frame_crc_ok = inspect(data, "B" if captured.channel == "B" else "A")
    errors = (0 if header_crc_ok else _HEADER_CRC_ERROR) | (0 if frame_crc_ok else _FRAME_CRC_ERROR)
    errors |= _CODING_ERROR if captured.collision else 0
    return bytes((measurement, errors)) + data[:-TRAILER_BYTES]


FLEXRAY_LINK = Link(LINK_TYPE_FLEXRAY, _frame_body)
"""How capture files keep FlexRay frames."""


def write_pcap(
    path: Path, capture: Iterable[Captured | CapturedSymbol], link: Link = FLEXRAY_LINK
) -> int:
    """Write a capture file; returns the number of packets. Raises OSError.

    Symbols are of FlexRay alone.
    """
    count = 0
    with path.open("wb") as file:
        file.write(file_header(link.number))
        for captured in capture:
            if isinstance(captured, Captured):
                file.write(timed(captured.time_us, link.body(captured)))
            else:
                file.write(packet(captured))
            count += 1
    return count
