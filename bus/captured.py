"""Frames on the wire, and how a capture file of Wireshark keeps them."""

import struct
from collections.abc import Callable
from typing import NamedTuple


class Captured(NamedTuple):
    """Bytes on the bus (a whole frame, right or wrong) and when they began.

    In a collision other bits were on the wire.
    """

    time_us: float
    data: bytes
    channel: str = "A"
    collision: bool = False


class Link(NamedTuple):
    """How capture files keep the frames of a bus.

    Attributes:
        number: link type in the file header (https://www.tcpdump.org/linktypes.html).
        body: the packet that stands for a frame.
    """

    number: int
    body: Callable[[Captured], bytes]


_MAGIC_NANOSECONDS = 0xA1B23C4D
_FILE_HEADER = struct.Struct("<IHHiIII")
_PACKET_HEADER = struct.Struct("<IIII")
_MAX_PACKET_BYTES = 65535


def file_header(link_type: int) -> bytes:
    """Return the beginning of a capture file; packets are appended to it."""
    return _FILE_HEADER.pack(_MAGIC_NANOSECONDS, 2, 4, 0, 0, _MAX_PACKET_BYTES, link_type)


def timed(time_us: float, body: bytes) -> bytes:
    """Return a packet of a capture file. Times count from 0, as in a simulation."""
    seconds, nanoseconds = divmod(round(time_us * 1e3), 1_000_000_000)
    return _PACKET_HEADER.pack(seconds, nanoseconds, len(body), len(body)) + body
