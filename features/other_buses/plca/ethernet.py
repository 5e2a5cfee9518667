"""Ethernet frames that carry shares: Ethernet II, broadcast, an EtherType for experiments.

Source: IEEE 802.3-2018, clause 3; IEEE 802-2014, clause 9.2.4 gives 0x88B5 to local experiments.
"""

import struct
import zlib

from concord.bus.bus import Captured, Link, Rejected
from concord.features.other_buses.identified_frames import Framing

MAX_NODES = 255
MIN_PAYLOAD_BYTES, MAX_PAYLOAD_BYTES = 46, 1500
PREAMBLE_BYTES = 8
HEADER_BYTES, CHECK_BYTES = 14, 4
GAP_BITS = 96
ETHER_TYPE = 0x88B5
_BROADCAST = b"\xff" * 6
# Locally administered, so no maker of devices owns it.
_SOURCE = b"\x02\x00\x00\x00\x00"
_TYPE = struct.pack(">H", ETHER_TYPE)
# CRC-32 has Hamming distance 4 for all frames of Ethernet (Koopman 2002, 32-bit cyclic redundancy
# codes for internet applications, table 1).
_NOTICED_BITS = 3
# Link type Ethernet, with four bytes of frame check sequence at the end of each packet.
_LINK_TYPE = 1 | 0x04000000 | 2 << 28


def padded(size: int) -> int:
    """Return the shortest payload of Ethernet for so many bytes."""
    return max(MIN_PAYLOAD_BYTES, size)


def pack(node: int, payload: bytes) -> bytes:
    """Return the frame of a node from its destination address to the frame check sequence."""
    frame = _BROADCAST + _SOURCE + bytes([node]) + _TYPE + payload.ljust(MIN_PAYLOAD_BYTES, b"\0")
    return frame + zlib.crc32(frame).to_bytes(CHECK_BYTES, "little")


def unpack(frame: bytes) -> tuple[int, bytes]:
    """Return the node and the payload of a frame.

    Raises:
        Rejected: it has a wrong length, check sequence, address or type.
    """
    size = len(frame) - HEADER_BYTES - CHECK_BYTES
    if size < MIN_PAYLOAD_BYTES:
        raise Rejected("too-short")
    if size > MAX_PAYLOAD_BYTES:
        raise Rejected("too-long")
    if zlib.crc32(frame[:-CHECK_BYTES]).to_bytes(CHECK_BYTES, "little") != frame[-CHECK_BYTES:]:
        raise Rejected("frame-crc")
    if frame[:11] != _BROADCAST + _SOURCE or frame[12:14] != _TYPE:
        raise Rejected("foreign")
    return frame[11], frame[HEADER_BYTES:-CHECK_BYTES]


def frame_bits(payload_bytes: int) -> int:
    """Return the bits of a frame from its preamble to its frame check sequence."""
    return 8 * (PREAMBLE_BYTES + HEADER_BYTES + padded(payload_bytes) + CHECK_BYTES)


def _captured(captured: Captured) -> bytes:
    """Return the frame, with wrong check sequence where a collision has changed its bits."""
    if not captured.collision:
        return captured.data
    return captured.data[:-1] + bytes([captured.data[-1] ^ 255])


FRAMING = Framing(
    name="ethernet",
    payload_limit_bytes=MAX_PAYLOAD_BYTES,
    overhead_bytes=HEADER_BYTES + CHECK_BYTES,
    leading_bytes=HEADER_BYTES,
    noticed_bits=_NOTICED_BITS,
    padded=padded,
    pack=pack,
    unpack=unpack,
    link=Link(_LINK_TYPE, _captured),
)
"""How shares travel in Ethernet frames."""
