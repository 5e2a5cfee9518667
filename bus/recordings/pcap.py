"""Frames as a capture file that Wireshark opens: pcap with link type 210 (FlexRay).

Each packet of a frame is a measurement header (channel, type), a byte of error flags, then header
and payload; the frame CRC is not stored, but the flags say whether it was right. A symbol is a
measurement header and the number of its low bits.
"""

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from concord.bus.flexray.frame import OVERHEAD_BYTES, TRAILER_BYTES, inspect

LINK_TYPE_FLEXRAY = 210
_MAGIC_NANOSECONDS = 0xA1B23C4D
_FILE_HEADER = struct.Struct("<IHHiIII")
_PACKET_HEADER = struct.Struct("<IIII")
_MAX_PACKET_BYTES = 65535
_TYPE_FRAME = 0x01
_TYPE_SYMBOL = 0x02
_MOST_SYMBOL_BITS = 127
_CHANNEL_B = 0x80
_FRAME_CRC_ERROR = 0x10
_HEADER_CRC_ERROR = 0x08
_CODING_ERROR = 0x02


class Captured(NamedTuple):
    """Bytes on the bus (a frame from header to frame CRC, right or wrong) and when they began.

    In a collision other bits were on the wire, so the frame has the coding error flag.
    """

    time_us: float
    data: bytes
    channel: str = "A"
    collision: bool = False


class CapturedSymbol(NamedTuple):
    """Low bits of a symbol on the bus and when they began."""

    time_us: float
    low_bits: int
    channel: str = "A"


def file_header() -> bytes:
    """The beginning of a capture file; packets are appended to it."""
    return _FILE_HEADER.pack(_MAGIC_NANOSECONDS, 2, 4, 0, 0, _MAX_PACKET_BYTES, LINK_TYPE_FLEXRAY)


def packet(captured: Captured | CapturedSymbol) -> bytes:
    """One frame or symbol as a packet of a capture file. Times count from 0, as in a simulation.

    Fewer bytes than any frame has are stored as they are, with the coding error flag.
    """
    channel = _CHANNEL_B if captured.channel == "B" else 0
    if isinstance(captured, CapturedSymbol):
        body = bytes((_TYPE_SYMBOL | channel, min(captured.low_bits, _MOST_SYMBOL_BITS)))
        return _timed(captured.time_us, body)
    data = captured.data
    measurement = _TYPE_FRAME | channel
    if len(data) < OVERHEAD_BYTES:
        body = bytes((measurement, _CODING_ERROR)) + data
    else:
        _, header_crc_ok, frame_crc_ok = inspect(data, "B" if captured.channel == "B" else "A")
        errors = (0 if header_crc_ok else _HEADER_CRC_ERROR) | (
            0 if frame_crc_ok else _FRAME_CRC_ERROR
        )
        errors |= _CODING_ERROR if captured.collision else 0
        body = bytes((measurement, errors)) + data[:-TRAILER_BYTES]
    return _timed(captured.time_us, body)


def _timed(time_us: float, body: bytes) -> bytes:
    seconds, nanoseconds = divmod(round(time_us * 1e3), 1_000_000_000)
    return _PACKET_HEADER.pack(seconds, nanoseconds, len(body), len(body)) + body


def write_pcap(path: Path, capture: Iterable[Captured | CapturedSymbol]) -> int:
    """Write a capture file; returns the number of packets. Raises OSError."""
    count = 0
    with path.open("wb") as file:
        file.write(file_header())
        for captured in capture:
            file.write(packet(captured))
            count += 1
    return count
