"""A share in FlexRay frames: the body cut into payloads, and what a frame says of its share.

The payload of each frame begins with the number of its communication cycle among those that carry
rounds. That number gives the step, as a step has a fixed number of them. The frame's own header
counts the cycles of the bus, also those between the steps (`bus/timebase.py`). Then comes the
frame's fragment of the body (`bus/fragments.py`). Two checksums guard the whole.
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import cast

import msgspec
from msgspec.structs import replace

from concord.bus.bus import Fragment, FrameFormat, Rejected
from concord.bus.flexray.frame import (
    HEADER_BYTES,
    MAX_FRAME_ID,
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    Channel,
    Frame,
    FrameError,
    is_intact,
)
from concord.bus.flexray.frame import decode as decode_frame
from concord.bus.flexray.frame import encode as encode_frame
from concord.bus.flexray.publication import Slot
from concord.bus.fragments import PREFIX_BYTES as NUMBERING_BYTES
from concord.bus.fragments import numbered, payload_sizes, read_body, split
from concord.bus.pcap import FLEXRAY_LINK

CYCLE_COUNTS = 64
_CYCLE = struct.Struct("<I")
PREFIX_BYTES = _CYCLE.size
# The frame CRC finds any so many wrong bits, whatever the length of the payload: its Hamming
# distance is 6 up to 248 bytes of payload and 4 beyond (protocol specification 2.1, 4.5).
_NOTICED_BITS = 3


def payload_lengths(share_bytes: int, limit_bytes: int = MAX_PAYLOAD_BYTES) -> tuple[int, ...]:
    """Payload length of each frame that a share takes where no payload exceeds the limit."""
    sizes = payload_sizes(share_bytes, limit_bytes - PREFIX_BYTES)
    return tuple(PREFIX_BYTES + size for size in sizes)


def to_frames(
    body: bytes, cycle: int, slots: Sequence[Slot], cycle_count: int | None = None
) -> list[bytes]:
    """The frames that carry `body` in the first of `slots`, as many as it takes. `cycle_count` is
    the bus's cycle counter; without it the bus has no cycles but those that carry rounds.

    Raises:
        ValueError: the body is longer than the slots are.
    """
    prefix = _CYCLE.pack(cycle)
    count = cycle % CYCLE_COUNTS if cycle_count is None else cycle_count
    fragments = split(body, slots[0].payload_bytes - PREFIX_BYTES)
    if len(fragments) > len(slots):
        raise ValueError(f"a share of {len(body)} bytes does not fit into {len(slots)} frames")
    return [
        encode_frame(
            Frame(
                slot.frame_id,
                count,
                (prefix + fragment).ljust(slot.payload_bytes if slot.fixed else 0, b"\0"),
                sync=slot.sync,
                startup=slot.startup,
            ),
            slot.checksum_channel,
        )
        for slot, fragment in zip(slots, fragments, strict=False)
    ]


def frame_payloads(share_bytes: int, slots: Sequence[Slot]) -> tuple[int, ...]:
    """Payload length of each frame that `to_frames` makes of a body of that length."""
    sizes = payload_sizes(share_bytes, slots[0].payload_bytes - PREFIX_BYTES)
    return tuple(
        max(PREFIX_BYTES + size, slot.payload_bytes if slot.fixed else 0)
        for slot, size in zip(slots, sizes, strict=False)
    )


class _Shape(msgspec.Struct, frozen=True):
    """A frame that carries a whole share, as its sender makes it: all that stands before the body
    but the number of the cycle between `header` and `numbering`, and its length."""

    header: bytes
    numbering: bytes
    frame_bytes: int


# Kept: turns repeat with the cycle counter.
@lru_cache(4096)
def _shape(slot: Slot, share_bytes: int, cycle_count: int) -> _Shape | None:
    """None where the share takes several frames."""
    if len(payload_sizes(share_bytes, slot.payload_bytes - PREFIX_BYTES)) > 1:
        return None
    (frame,) = to_frames(bytes(share_bytes), 0, [slot], cycle_count)
    start = HEADER_BYTES + PREFIX_BYTES
    numbering = frame[start : start + NUMBERING_BYTES]
    return _Shape(frame[:HEADER_BYTES], numbering, len(frame))


def whole_body(
    frame: bytes, slot: Slot, share_bytes: int, cycle: int, cycle_count: int
) -> bytes | None:
    """The body in a frame that is bit by bit what `to_frames` makes of one of that length in this
    slot and cycle; None for every other frame, which `read_frame` looks at more closely."""
    shape = _shape(slot, share_bytes, cycle_count)
    if shape is None or len(frame) != shape.frame_bytes:
        return None
    start = shape.header + _CYCLE.pack(cycle) + shape.numbering
    if not (frame.startswith(start) and is_intact(frame, slot.checksum_channel)):
        return None
    return frame[len(start) : len(start) + share_bytes]


def read_frame(data: bytes) -> Fragment:
    """Return the fragment in a frame, with the count of its header.

    Raises:
        Rejected: with the reason of the check that failed.
    """
    try:
        frame, channel = _opened(data)
    except FrameError as error:
        raise Rejected(error.reason) from None
    if frame.null:
        raise Rejected("null-frame")
    if len(frame.payload) < PREFIX_BYTES:
        raise Rejected("too-short")
    cycle = _CYCLE.unpack_from(frame.payload)[0]
    data = frame.payload[PREFIX_BYTES:]
    return Fragment(frame.frame_id, cycle, data, frame.cycle_count, channel)


def _opened(data: bytes) -> tuple[Frame, Channel]:
    """Return a frame, and the channel whose checksum it has.

    Raises:
        FrameError: it is no frame on either channel.
    """
    channel: Channel = "B" if not is_intact(data) and is_intact(data, "B") else "A"
    return decode_frame(data, channel), channel


def renumbered(frame: bytes, cycle: int, cycle_count: int) -> bytes:
    """The frame with the number of another cycle in its payload and the count of it in its header,
    and its checksums right.

    Raises:
        FrameError: it is no frame.
    """
    told, channel = _opened(frame)
    payload = _CYCLE.pack(cycle) + told.payload[PREFIX_BYTES:]
    return encode_frame(replace(told, cycle_count=cycle_count, payload=payload), channel)


def in_slot(frame: bytes, frame_id: int, channel: Channel = "A") -> bytes:
    """The frame with the ID of another slot and on its channel, the checksums right.

    Raises:
        FrameError: it is no frame.
    """
    told, _ = _opened(frame)
    return encode_frame(Frame(frame_id, told.cycle_count, told.payload), channel)


def emptied(frame: bytes) -> bytes:
    """The null frame in the place of a sound one.

    Raises:
        FrameError: it is no frame.
    """
    told, channel = _opened(frame)
    payload = bytes(len(told.payload))
    return encode_frame(replace(told, payload=payload, null=True), channel)


def null_frame(slot: Slot, cycle_count: int) -> bytes:
    """The frame in a static slot whose owner has nothing to send."""
    payload = bytes(slot.payload_bytes)
    return encode_frame(
        Frame(slot.frame_id, cycle_count, payload, null=True, sync=slot.sync, startup=slot.startup)
    )


def on_channel(frame: bytes, channel: str) -> bytes:
    """The frame as it is on a channel: one on both travels with the checksum of channel A.

    Raises:
        FrameError: it is no frame.
    """
    told, travels = _opened(frame)
    return frame if channel == travels else encode_frame(told, cast(Channel, channel))


def miscounted(frame: bytes, cycles: int) -> bytes:
    """The frame whose header counts so many cycles more than its payload.

    Raises:
        FrameError: it is no frame.
    """
    told, channel = _opened(frame)
    count = (told.cycle_count + cycles) % CYCLE_COUNTS
    return encode_frame(replace(told, cycle_count=count), channel)


def cycle_of(frame: bytes) -> int:
    """The cycle that a frame's payload begins with, unchecked; 0 where the frame is too short."""
    whole = len(frame) >= HEADER_BYTES + PREFIX_BYTES
    return _CYCLE.unpack_from(frame, HEADER_BYTES)[0] if whole else 0


def frame_id_of(frame: bytes) -> int:
    """The frame ID in a frame's header, unchecked: the last 11 of its first 16 bits."""
    return int.from_bytes(frame[:2], "big") & MAX_FRAME_ID


SHARE_FRAMES = FrameFormat(
    name="flexray",
    link=FLEXRAY_LINK,
    payload_limit_bytes=MAX_PAYLOAD_BYTES,
    overhead_bytes=OVERHEAD_BYTES,
    numbering_bytes=PREFIX_BYTES + NUMBERING_BYTES,
    noticed_bits=_NOTICED_BITS,
    read=read_frame,
    cycle_of=cycle_of,
    numbered=numbered,
    join=read_body,
    emptied=emptied,
    miscounted=miscounted,
    on_channel=on_channel,
)
"""How shares travel in FlexRay frames."""
