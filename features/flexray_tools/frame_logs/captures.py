"""Frames of capture files: pcap and pcapng, with packets of FlexRay (link type 210) or SocketCAN.

The formats are those of the IETF drafts draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng, the
packets those of https://www.tcpdump.org/linktypes.html.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from concord.bus.pcap import LINK_TYPE_FLEXRAY
from concord.features.flexray_tools.frame_logs.frames import (
    BAD_FRAME,
    BAD_HEADER,
    FrameBlock,
    FrameLogError,
    from_headers,
)

LINK_TYPE_SOCKETCAN = 227
_READ_BYTES = 2_000_000
_LONGEST_PACKET_BYTES = 1 << 20
_NANOSECONDS = {0xA1B2C3D4: 1000, 0xA1B23C4D: 1}
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_BYTE_ORDER = 0x1A2B3C4D
_RESOLUTION, _OFFSET = 9, 14
_IN_FRONT_BYTES, _CAN_HEADER_BYTES = 7, 8
_HEADER_ERROR, _FRAME_ERRORS = 0x08, 0x17
_CAN_ERROR, _CAN_IDENTIFIER = 0x20000000, 0x1FFFFFFF


class _Packets(NamedTuple):
    """Packets of one link type in `data`: times, first bytes and lengths, (n,) each."""

    link: int
    time_ns: NDArray[np.int64]
    start: NDArray[np.int64]
    length: NDArray[np.int64]
    data: bytes


def is_capture(head: bytes) -> bool:
    """Return whether a file that begins with these four bytes is a pcap or pcapng capture."""
    numbers = (
        {struct.unpack(order + "I", head[:4])[0] for order in "<>"} if len(head) > 3 else set()
    )
    return bool(numbers & {_SECTION, *_NANOSECONDS})


def capture_blocks(file: BinaryIO, skipped: Counter[str]) -> Iterator[FrameBlock]:
    """Yield the frames of a capture; `skipped` counts what is no frame, by its name.

    Raises:
        FrameLogError: the file is no capture, or holds a packet that no capture has.
    """
    head = file.read(4)
    file.seek(0)
    named = struct.unpack("<I", head)[0] == _SECTION
    packets = _pcapng_packets(file, skipped) if named else _pcap_packets(file, skipped)
    kind = None
    for some in packets:
        build = {LINK_TYPE_FLEXRAY: _flexray_block, LINK_TYPE_SOCKETCAN: _can_block}.get(some.link)
        if build is None:
            skipped[f"packets of link type {some.link}"] += len(some.start)
            continue
        block = build(some, skipped)
        kind = kind or block.kind
        if block.kind != kind:
            skipped[f"frames of another bus ({block.kind})"] += len(block.start)
        elif len(block.start):
            yield block


def _pcap_packets(file: BinaryIO, skipped: Counter[str]) -> Iterator[_Packets]:
    head = file.read(24)
    order = "<" if struct.unpack("<I", head[:4])[0] in _NANOSECONDS else ">"
    if len(head) < 24:
        raise FrameLogError("the capture ends in its header; record it anew")
    unit_ns = _NANOSECONDS[struct.unpack(order + "I", head[:4])[0]]
    link = struct.unpack(order + "I", head[20:])[0] & 0xFFFF
    length_of = struct.Struct(order + "I").unpack_from
    data = b""
    while more := file.read(_READ_BYTES):
        data += more
        places: list[int] = []
        place, end = 0, len(data)
        while place + 16 <= end:
            after = place + 16 + length_of(data, place + 8)[0]
            if after > end:
                _check_length(after - place)
                break
            places.append(place)
            place = after
        at = np.array(places, dtype=np.int64)
        words = _words(data, at, 3, order)
        time_ns = words[:, 0] * 1_000_000_000 + words[:, 1] * unit_ns
        yield _Packets(link, time_ns, at + 16, words[:, 2], data)
        data = data[place:]
    skipped["packet cut at the end of the file"] += bool(data)


def _check_length(length: int) -> None:
    if length > _LONGEST_PACKET_BYTES:
        raise FrameLogError(
            f"a packet of {length} bytes, and a capture of a bus has none; the file is damaged, "
            "so record it anew, or mend it with `editcap`"
        )


def _words(data: bytes, at: NDArray[np.int64], count: int, order: str) -> NDArray[np.int64]:
    """Return so many words (n, count) of 32 bits from each place on."""
    octets = np.frombuffer(data, dtype=np.uint8)
    rows = octets[at[:, None] + np.arange(4 * count)]
    return rows.reshape(-1).view(order + "u4").reshape(len(at), count).astype(np.int64)


class _Interface(NamedTuple):
    """Link type of an interface of a pcapng file, ticks of its clock a second, and its zero."""

    link: int
    ticks: int
    offset_s: int


def _pcapng_packets(file: BinaryIO, skipped: Counter[str]) -> Iterator[_Packets]:
    order, interfaces = "<", list[_Interface]()
    found: dict[_Interface, list[tuple[int, int, int]]] = {}
    bodies, size = list[bytes](), 0
    while True:
        head = file.read(8)
        if len(head) < 8:
            skipped["packet cut at the end of the file"] += bool(head)
            break
        kind = struct.unpack(order + "I", head[:4])[0]
        if kind == _SECTION:
            mark = file.read(4)
            order = "<" if struct.unpack("<I", mark)[0] == _BYTE_ORDER else ">"
            head, interfaces = head + mark, []
        length = struct.unpack(order + "I", head[4:8])[0]
        _check_length(length)
        body = file.read(length - len(head))
        if len(body) < length - len(head) or length < 12:
            skipped["packet cut at the end of the file"] += 1
            break
        if kind == _INTERFACE:
            interfaces.append(_interface(body, order))
        elif kind == _PACKET:
            number, high, low, captured = struct.unpack_from(order + "4I", body)
            if number >= len(interfaces):
                raise FrameLogError(f"a packet of interface {number}, which the capture lacks")
            one = found.setdefault(interfaces[number], [])
            one.append((high << 32 | low, size + 20, captured))
            bodies.append(body)
            size += len(body)
        elif kind != _SECTION:
            skipped["blocks without frames"] += 1
        if size > _READ_BYTES:
            yield from _of_interfaces(found, b"".join(bodies))
            found, bodies, size = {}, [], 0
    yield from _of_interfaces(found, b"".join(bodies))


def _interface(body: bytes, order: str) -> _Interface:
    """Return what an interface description says; times are in microseconds without its option."""
    link = struct.unpack_from(order + "H", body)[0]
    ticks, offset_s, place = 1_000_000, 0, 8
    while place + 4 <= len(body) - 4:
        code, length = struct.unpack_from(order + "HH", body, place)
        value = body[place + 4 : place + 4 + length]
        if code == 0:
            break
        if code == _RESOLUTION and value:
            ticks = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        if code == _OFFSET and length == 8:
            offset_s = struct.unpack(order + "q", value)[0]
        place += 4 + length + -length % 4
    return _Interface(link, ticks, offset_s)


def _of_interfaces(
    found: dict[_Interface, list[tuple[int, int, int]]], data: bytes
) -> Iterator[_Packets]:
    for one, rows in found.items():
        # Ticks since 1970 leave the whole numbers of numpy when they become nanoseconds.
        time_ns = [
            one.offset_s * 1_000_000_000 + ticks * 1_000_000_000 // one.ticks
            for ticks, _, _ in rows
        ]
        columns = np.array([row[1:] for row in rows], dtype=np.int64).reshape(-1, 2)
        yield _Packets(one.link, np.array(time_ns, np.int64), columns[:, 0], columns[:, 1], data)


def _flexray_block(packets: _Packets, skipped: Counter[str]) -> FrameBlock:
    octets = np.frombuffer(packets.data, dtype=np.uint8)
    start, length = packets.start, packets.length
    kind = octets[np.minimum(start, len(octets) - 1)] if len(start) else np.zeros(0, np.uint8)
    symbols = (kind & 0x7F == 2) & (length >= 2)
    frames = (kind & 0x7F == 1) & (length >= _IN_FRONT_BYTES)
    skipped["symbols"] += int(symbols.sum())
    skipped["packets that are no frame"] += int((~frames & ~symbols).sum())
    start, length = start[frames], length[frames]
    rows = octets[start[:, None] + np.arange(_IN_FRONT_BYTES)]
    errors = np.where(rows[:, 1] & _HEADER_ERROR, BAD_HEADER, 0)
    errors |= np.where(rows[:, 1] & _FRAME_ERRORS, BAD_FRAME, 0)
    ids, cycles, flags, announced = from_headers(rows[:, 2:], errors.astype(np.uint8))
    there = length - _IN_FRONT_BYTES
    # A controller may leave out the zeros of a null frame.
    cut = (there < announced) & (flags & 1 == 0)
    skipped["payloads that are cut"] += int(cut.sum())
    return FrameBlock(
        packets.time_ns[frames],
        (rows[:, 0] >> 7).astype(np.uint8),
        ids,
        cycles,
        flags,
        start + _IN_FRONT_BYTES,
        np.minimum(there, announced),
        packets.data,
    )


def _can_block(packets: _Packets, skipped: Counter[str]) -> FrameBlock:
    long = packets.length >= _CAN_HEADER_BYTES
    words = _words(packets.data, packets.start[long], 2, ">")
    sound = words[:, 0] & _CAN_ERROR == 0
    skipped["packets that are no frame"] += int((~long).sum())
    skipped["error messages"] += int((~sound).sum())
    there = packets.length[long][sound] - _CAN_HEADER_BYTES
    none = np.zeros(int(sound.sum()), np.uint8)
    return FrameBlock(
        packets.time_ns[long][sound],
        none,
        words[sound, 0] & _CAN_IDENTIFIER,
        none,
        none,
        packets.start[long][sound] + _CAN_HEADER_BYTES,
        np.minimum(there, words[sound, 1] >> 24),
        packets.data,
        "can",
    )
