"""Bytes that no sound process says, by kind in turn, made of what sound ones have said."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from concord.bus.flexray.frame import MAX_PAYLOAD_BYTES, decode, encode
from concord.bus.flexray.share_frames import CYCLE_COUNTS, PREFIX_BYTES, in_slot, renumbered
from concord.nodes.bounds import MAX_FRAME_BYTES, MAX_MESSAGE_BYTES

# No schedule here has slots of these numbers, no run cycles as late as these.
_NO_SLOT, _LAST_CYCLE, _FAR_CYCLE = 1500, 2000, 1 << 30
_NO_ROUNDS = {"what": "settings", "settings": {"rounds": 0}, "first_cycle": 0}
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
    cycle = int(rng.integers(_LAST_CYCLE))
    return in_slot(
        renumbered(whole, cycle, cycle % CYCLE_COUNTS), _NO_SLOT + int(rng.integers(500))
    )


def _wrong_cycle(whole: bytes, rng: np.random.Generator) -> bytes:
    cycle = _FAR_CYCLE + int(rng.integers(1000))
    return renumbered(whole, cycle, cycle % CYCLE_COUNTS)


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


def _deep(whole: bytes, rng: np.random.Generator) -> bytes:
    return whole[:-1] + b',"x":' + b'{"x":' * int(rng.integers(1, 1500))


def _long_number(whole: bytes, rng: np.random.Generator) -> bytes:
    return b'{"node":%b,"step":0}' % (b"9" * int(rng.integers(20, 6000)))


def _not_finite(whole: bytes, rng: np.random.Generator) -> bytes:
    wrong = (b"NaN", b"Infinity", b"-Infinity", b"1e999", b"nan")
    return b'{"node":%b,"step":0}' % wrong[int(rng.integers(len(wrong)))]


def _no_text(whole: bytes, rng: np.random.Generator) -> bytes:
    wrong = (b"\xed\xa0\x80", b"\xc0\x80", b"\x00", b"\\ud800")
    return b'{"%b":0}' % wrong[int(rng.integers(len(wrong)))]


def _impossible(whole: bytes, rng: np.random.Generator) -> bytes:
    """A body of what are no numbers, or too large for any: the frame is whole, and late."""
    told = decode(whole)
    wrong = (b"\xff\xff\xff\x7f", b"\x00\x00\x80\x7f", b"\xff\xff\x7f\xff")
    fill = wrong[int(rng.integers(len(wrong)))] * len(told.payload)
    return encode(replace(told, payload=(told.payload[:PREFIX_BYTES] + fill)[: len(told.payload)]))


def _other_length(whole: bytes, rng: np.random.Generator) -> bytes:
    told = decode(whole)
    words = int(rng.integers(PREFIX_BYTES // 2, MAX_PAYLOAD_BYTES // 2))
    return encode(replace(told, payload=told.payload.ljust(MAX_PAYLOAD_BYTES, b"\0")[: 2 * words]))


def _misfit(whole: bytes, rng: np.random.Generator) -> bytes:
    """A heartbeat with other readings than any node has, or of impossible rounds."""
    told = msgspec.json.decode(whole) | {"step": int(rng.integers(_LAST_CYCLE))}
    wrong = {"readings": [[1e308] * 9]}, {"readings": [[]] * 9}, {"changes": [_NO_ROUNDS]}
    return msgspec.json.encode(told | wrong[int(rng.integers(len(wrong)))])


Spoil = Callable[[bytes, np.random.Generator], bytes]
# The checksums of these are wrong; of the others they are right.
DAMAGED: tuple[Spoil, ...] = (_random, _truncated, _flipped, _lengthened)
WHOLE: tuple[Spoil, ...] = (_replayed,)
FRAMES: tuple[Spoil, ...] = (
    *DAMAGED, _wrong_slot, _wrong_cycle, _replayed, _impossible, _other_length,
)  # fmt: skip
JSON: tuple[Spoil, ...] = (
    _random, _truncated, _lengthened, _spoilt, _wrong_fields, _nested, _deep, _long_number,
    _not_finite, _no_text,
)  # fmt: skip
MISFITS: tuple[Spoil, ...] = (_replayed, _misfit)


def malformed(number: int, ways: Sequence[Spoil], whole: bytes, rng: np.random.Generator) -> bytes:
    """The malformed message of that number, made of a whole one."""
    if number % _HUGE_EVERY == _HUGE_EVERY - 1:
        return b"\xff" * (MAX_MESSAGE_BYTES + 1)
    return ways[number % len(ways)](whole, rng)
