"""CAN FD frames as bytes: what travels in every driver, and the packets of a capture.

Four bytes have the identifier, one the data length code, then come the data. The last four have a
bit of even parity over the whole frame, the stuff count and the CRC. The parity is no part of CAN
FD: a wrong bit moves stuff bits, after which no theorem promises that the CRC finds it.
"""

import struct
from functools import partial

from concord.bus.bus import Captured, Link, Rejected
from concord.features.other_buses.can_fd.bits import (
    BASE_BITS,
    DATA_BYTES,
    EXTENDED_BITS,
    crc_of,
    padded,
    wire,
)
from concord.features.other_buses.identified_frames import Framing

_HEADER = struct.Struct(">IB")
_CHECK_BYTES = 4
_PARITY = 1 << 31
_NOTICED_BITS = 1
LINK_TYPE_SOCKETCAN = 227
_SOCKET_HEADER = struct.Struct(">IBB2x")
_EXTENDED, _ERROR = 0x80000000, 0x20000000
_BIT_RATE_SWITCH, _FLEXIBLE = 0x01, 0x04
# Of error messages (linux/can/error.h): a protocol violation, its kind and its place.
_PROTOCOL, _BIT_ERROR, _IN_CRC = 0x08, 0x01, 0x08


def pack(identifier_bits: int, identifier: int, payload: bytes) -> bytes:
    """Return the frame of an identifier and a payload, padded to a length of CAN FD."""
    data = payload.ljust(padded(len(payload)), b"\0")
    made = wire(identifier, identifier_bits, data)
    check = made.stuff_count << crc_of(len(data))[0] | made.crc
    frame = _HEADER.pack(identifier, DATA_BYTES.index(len(data))) + data
    odd = (int.from_bytes(frame, "big").bit_count() + check.bit_count()) % 2
    return frame + (check | _PARITY * odd).to_bytes(_CHECK_BYTES, "big")


def unpack(identifier_bits: int, frame: bytes) -> tuple[int, bytes]:
    """Return the identifier and the payload of a frame.

    Raises:
        Rejected: it has a wrong length, identifier, stuff count or checksum.
    """
    if len(frame) < _HEADER.size + _CHECK_BYTES:
        raise Rejected("too-short")
    identifier, code = _HEADER.unpack_from(frame)
    data = frame[_HEADER.size : -_CHECK_BYTES]
    if code >= len(DATA_BYTES) or len(data) != DATA_BYTES[code]:
        raise Rejected("length")
    if identifier >> identifier_bits:
        raise Rejected("foreign")
    if pack(identifier_bits, identifier, data) != frame:
        raise Rejected("frame-crc")
    return identifier, data


def _captured(identifier_bits: int, captured: Captured) -> bytes:
    """Return the frame as SocketCAN has it, or the error message in its place."""
    try:
        identifier, data = unpack(identifier_bits, captured.data)
    except Rejected:
        return _error(0, _IN_CRC)
    if captured.collision:
        return _error(_BIT_ERROR, 0)
    flag = _EXTENDED if identifier_bits == EXTENDED_BITS else 0
    return _SOCKET_HEADER.pack(identifier | flag, len(data), _BIT_RATE_SWITCH | _FLEXIBLE) + data


def _error(kind: int, place: int) -> bytes:
    return _SOCKET_HEADER.pack(_ERROR | _PROTOCOL, 8, 0) + bytes((0, 0, kind, place, 0, 0, 0, 0))


def _framing(identifier_bits: int) -> Framing:
    return Framing(
        name="can-fd",
        payload_limit_bytes=DATA_BYTES[-1],
        overhead_bytes=_HEADER.size + _CHECK_BYTES,
        leading_bytes=_HEADER.size,
        noticed_bits=_NOTICED_BITS,
        padded=padded,
        pack=partial(pack, identifier_bits),
        unpack=partial(unpack, identifier_bits),
        link=Link(LINK_TYPE_SOCKETCAN, partial(_captured, identifier_bits)),
    )


FRAMINGS = {bits: _framing(bits) for bits in (BASE_BITS, EXTENDED_BITS)}
"""How shares travel in CAN FD frames, by the bits of their identifiers."""
