"""Shares in frames that carry an identifier of their sender, on buses without slots.

The payload of each frame begins with the number of its communication cycle since the start. Then
comes the frame's fragment of the body (`bus/fragments.py`) and padding. The frame ID of a fragment
(`bus.Fragment`) joins the identifier of its frame with the number of the fragment.
"""

import struct
from collections.abc import Callable
from typing import NamedTuple

from concord.bus.bus import Fragment, FrameFormat, Link, Rejected
from concord.bus.fragments import (
    PREFIX_BYTES,
    Padded,
    numbered,
    payload_sizes,
    read_body,
    split,
)

_CYCLE = struct.Struct("<I")
CYCLE_BYTES = _CYCLE.size
NUMBERING_BYTES = CYCLE_BYTES + PREFIX_BYTES
# Of a frame ID: fragments of a share are numbered with eight bits.
_NUMBERS = 256
_LAST_BIT = 1


class Framing(NamedTuple):
    """The frames of a bus: an identifier and a payload, and the bytes of both.

    Attributes:
        name: of the encoding, as a recording states it.
        payload_limit_bytes: longest payload of a frame.
        overhead_bytes: of a frame beside its payload; `leading_bytes` of them stand before it.
        noticed_bits: a receiver finds any this many wrong bits in a frame.
        padded: the shortest payload that holds so many bytes.
        pack: the frame of an identifier and a payload.
        unpack: identifier and payload of a frame; raises `Rejected` for one that is not sound.
        link: how capture files keep the frames.
    """

    name: str
    payload_limit_bytes: int
    overhead_bytes: int
    leading_bytes: int
    noticed_bits: int
    padded: Padded
    pack: Callable[[int, bytes], bytes]
    unpack: Callable[[bytes], tuple[int, bytes]]
    link: Link

    def sizes(self, share_bytes: int) -> tuple[int, ...]:
        """Return the payload length of each frame of a share."""
        limit = self.payload_limit_bytes - CYCLE_BYTES
        return tuple(
            CYCLE_BYTES + size for size in payload_sizes(share_bytes, limit, self._padded_fragment)
        )

    def frames(self, body: bytes, cycle: int, identifier: int) -> list[bytes]:
        """Return the frames of a share."""
        limit, prefix = self.payload_limit_bytes - CYCLE_BYTES, _CYCLE.pack(cycle)
        return [
            self.pack(identifier, prefix + fragment)
            for fragment in split(body, limit, self._padded_fragment)
        ]

    def read(self, frame: bytes) -> Fragment:
        """Return the fragment in a frame.

        Raises:
            Rejected: with the reason of the check that failed.
        """
        identifier, payload = self.unpack(frame)
        if len(payload) < NUMBERING_BYTES:
            raise Rejected("too-short")
        data = payload[CYCLE_BYTES:]
        if not any(payload):
            raise Rejected("null-frame")
        return Fragment(identifier * _NUMBERS + data[0], _CYCLE.unpack_from(payload)[0], data)

    def whole_body(self, frame: bytes, cycle: int, body_bytes: int) -> tuple[int, bytes] | None:
        """Return identifier and body of a frame that carries a whole share of that length, bit by
        bit as `frames` makes it; None for every other frame."""
        try:
            identifier, payload = self.unpack(frame)
        except Rejected:
            return None
        body = payload[NUMBERING_BYTES : NUMBERING_BYTES + body_bytes]
        # Every other frame differs from the one that its own body would make.
        same = len(body) == body_bytes and self.frames(body, cycle, identifier) == [frame]
        return (identifier, body) if same else None

    def renumbered(self, frame: bytes, cycle: int) -> bytes:
        """Return a sound frame with the number of another cycle."""
        identifier, payload = self.unpack(frame)
        return self.pack(identifier, _CYCLE.pack(cycle) + payload[CYCLE_BYTES:])

    def identified(self, frame: bytes, identifier: int) -> bytes:
        """Return a sound frame with another identifier."""
        return self.pack(identifier, self.unpack(frame)[1])

    def cycle_of(self, frame: bytes) -> int:
        """Return the cycle that a frame names, unchecked; 0 where the frame is too short."""
        whole = len(frame) >= self.leading_bytes + CYCLE_BYTES
        return _CYCLE.unpack_from(frame, self.leading_bytes)[0] if whole else 0

    def emptied(self, frame: bytes) -> bytes:
        """Return the frame of the same length with zeros for a payload."""
        identifier, payload = self.unpack(frame)
        return self.pack(identifier, bytes(len(payload)))

    def frame_format(self) -> FrameFormat:
        """Return the face of these frames that nodes, drivers and reports know."""
        return FrameFormat(
            name=self.name,
            link=self.link,
            payload_limit_bytes=self.payload_limit_bytes,
            overhead_bytes=self.overhead_bytes,
            numbering_bytes=NUMBERING_BYTES,
            noticed_bits=self.noticed_bits,
            read=self.read,
            cycle_of=self.cycle_of,
            numbered=numbered,
            join=read_body,
            emptied=self.emptied,
            # No header counts cycles, so the checksum stands for what a receiver must notice.
            miscounted=lambda frame, cycles: frame[:-1] + bytes([frame[-1] ^ _LAST_BIT]),
            on_channel=lambda frame, channel: frame,
        )

    def _padded_fragment(self, size: int) -> int:
        return self.padded(size + CYCLE_BYTES) - CYCLE_BYTES


def identifier_of(frame_id: int) -> int:
    """Return the identifier of the frame with this frame ID."""
    return frame_id // _NUMBERS


def frame_id_of(identifier: int, number: int) -> int:
    """Return the frame ID of fragment `number` of a share."""
    return identifier * _NUMBERS + number
