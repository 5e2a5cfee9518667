"""Bytes that no sound process says, by kind in turn, made of what sound ones have said."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from nodes.bounds import MAX_FRAME_BYTES, MAX_MESSAGE_BYTES
from nodes.share import in_slot, renumbered

# No schedule here has slots of these numbers, no run cycles as late as these.
_NO_SLOT, _LAST_CYCLE, _FAR_CYCLE = 1500, 2000, 1 << 30
# So seldom comes what is longer than anything may be.
_HUGE_EVERY = 5000


def _random(whole: bytes, rng: np.random.Generator) -> bytes:
    # No JSON begins so, and no frame ends so by chance.
    return b"\xff" + rng.bytes(int(rng.integers(0, MAX_FRAME_BYTES)))


def _truncated(whole: bytes, rng: np.random.Generator) -> bytes:
    return whole[: int(rng.integers(1, len(whole)))]


def _lengthened(whole: bytes, rng: np.random.Generator) -> bytes:
    return whole + b"\xff" * int(rng.integers(1, 9))


def _flipped(whole: bytes, rng: np.random.Generator) -> bytes:
    """One to three bits, which the frame's checksum always finds."""
    damaged = bytearray(whole)
    for place in set(rng.integers(0, 8 * len(whole), 3).tolist()):
        damaged[place // 8] ^= 1 << place % 8
    return bytes(damaged)


def _wrong_slot(whole: bytes, rng: np.random.Generator) -> bytes:
    moved = renumbered(whole, int(rng.integers(_LAST_CYCLE)))
    return in_slot(moved, _NO_SLOT + int(rng.integers(500)))


def _wrong_cycle(whole: bytes, rng: np.random.Generator) -> bytes:
    return renumbered(whole, _FAR_CYCLE + int(rng.integers(1000)))


def _replayed(whole: bytes, rng: np.random.Generator) -> bytes:
    return whole


def _spoilt(whole: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(whole)))
    return whole[:place] + b"\x00" + whole[place + 1 :]


def _wrong_fields(whole: bytes, rng: np.random.Generator) -> bytes:
    wrong = [-1, 1 << 40, "x", [], None, {"node": {}}]
    return msgspec.json.encode({"node": wrong[int(rng.integers(len(wrong)))], "step": 1.5})


def _nested(whole: bytes, rng: np.random.Generator) -> bytes:
    return b"[" * int(rng.integers(1, 5000))


Spoil = Callable[[bytes, np.random.Generator], bytes]
# The checksums of these are wrong; of the others they are right.
DAMAGED: tuple[Spoil, ...] = (_random, _truncated, _flipped, _lengthened)
FRAMES: tuple[Spoil, ...] = (*DAMAGED, _wrong_slot, _wrong_cycle, _replayed)
JSON: tuple[Spoil, ...] = (_random, _truncated, _lengthened, _spoilt, _wrong_fields, _nested)


def malformed(number: int, ways: Sequence[Spoil], whole: bytes, rng: np.random.Generator) -> bytes:
    """The malformed message of that number, made of a whole one."""
    if number % _HUGE_EVERY == _HUGE_EVERY - 1:
        return b"\xff" * (MAX_MESSAGE_BYTES + 1)
    return ways[number % len(ways)](whole, rng)
