"""A share on the bus: the body cut into FlexRay frames, and what a frame says of its share.

The payload of each frame begins with the step, then its fragment of the body (`bus/fragments.py`).
The frame's own header says whose slot it was and the cycle counter (0..63), and its two checksums
guard both.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from bus.fragments import FragmentError, join, payload_sizes, split
from bus.frame import MAX_PAYLOAD_BYTES, Frame, FrameError
from bus.frame import decode as decode_frame
from bus.frame import encode as encode_frame
from nodes.estimator import Rejected

CYCLE_COUNTS = 64
_STEP = struct.Struct("<I")
_FRAGMENT_LIMIT_BYTES = MAX_PAYLOAD_BYTES - _STEP.size


class Fragment(NamedTuple):
    """What one frame carries of a share, and in which cycle since the start it was sent."""

    frame_id: int
    cycle: int
    data: bytes


def payload_lengths(share_bytes: int) -> tuple[int, ...]:
    """Payload length of each frame that a share of that many bytes takes."""
    sizes = payload_sizes(share_bytes, _FRAGMENT_LIMIT_BYTES)
    return tuple(_STEP.size + size for size in sizes)


def to_frames(body: bytes, step: int, cycle: int, frame_ids: Sequence[int]) -> list[bytes]:
    """The frames that carry `body`, one for each of `frame_ids`, ready for the bus."""
    prefix = _STEP.pack(step)
    return [
        encode_frame(Frame(frame_id, cycle % CYCLE_COUNTS, prefix + fragment))
        for frame_id, fragment in zip(frame_ids, split(body, _FRAGMENT_LIMIT_BYTES), strict=True)
    ]


def read_frame(data: bytes, rounds: int) -> Fragment:
    """What a frame carries.

    The step says in which cycle its rounds begin, the six-bit counter which of them it was (a step
    has fewer than 64 rounds).

    Raises:
        Rejected: with the reason of the check that failed.
    """
    try:
        frame = decode_frame(data)
    except FrameError as error:
        raise Rejected(error.reason) from None
    if frame.null:
        raise Rejected("null-frame")
    if len(frame.payload) < _STEP.size:
        raise Rejected("too-short")
    first = _STEP.unpack_from(frame.payload)[0] * rounds
    number = (frame.cycle_count - first) % CYCLE_COUNTS
    if number >= rounds:
        raise Rejected("cycle-count")
    return Fragment(frame.frame_id, first + number, frame.payload[_STEP.size :])


def read_body(fragments: Sequence[bytes]) -> bytes:
    """The body of a share whose fragments have all come.

    Raises:
        Rejected: they do not belong together.
    """
    try:
        return join(fragments)
    except FragmentError as error:
        raise Rejected(f"fragment-{error.reason}") from None


def step_of(frame: bytes) -> int:
    """The step that a frame's payload begins with, unchecked; 0 where the frame is too short."""
    start = 5
    return _STEP.unpack_from(frame, start)[0] if len(frame) >= start + _STEP.size else 0
