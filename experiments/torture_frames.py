"""What becomes of single frames on their way while a case lasts: a link that is hostile.

A fault of frames is a kind and a probability, "duplicate 0.2". The fate of a frame is a hash of the
seed, the kind, sender, receiver, cycle and number of the frame, so that taking one fault away
leaves all others as they were.
"""

import hashlib
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence

from bus.frame import Frame, decode, encode
from nodes.share import cycle_of

LOSING = ("vanish", "corrupt", "delay")
HARMLESS = ("duplicate", "garbage", "replay", "spoof", "reorder")
FRAME_FAULTS = LOSING + HARMLESS

_DRAWN = struct.Struct("<QHHIB")
_MOST_FLIPS = 3
_MOST_DELAY = 4


def chance(
    seed: int, kind: str, sender: int, receiver: int, frame: bytes, number: int = 0
) -> float:
    """A number in [0, 1) that belongs to a frame on its way, and to what is asked of it."""
    identity = int.from_bytes(frame[:2], "big") % 2048
    where = _DRAWN.pack(seed, sender, receiver, cycle_of(frame), number)
    digest = hashlib.blake2b(where, digest_size=8, person=kind.encode(), salt=b"%d" % identity)
    return int.from_bytes(digest.digest(), "big") / 2**64


def read_frame_faults(words: Sequence[str]) -> dict[str, float]:
    """Kinds of faults and their probabilities.

    Raises:
        ValueError: a word that is no fault of frames, or a probability that is none.
    """
    faults = {}
    for word in words:
        kind, _, text = word.strip().partition(" ")
        try:
            faults[kind] = float(text)
        except ValueError:
            faults[kind] = float("nan")
        if kind not in FRAME_FAULTS or not 0 <= faults[kind] <= 1:
            raise ValueError(
                f"--frame-faults {word!r}: must be a kind and a probability, as in 'duplicate "
                f"0.2'; kinds are {', '.join(FRAME_FAULTS)}"
            )
    return faults


class HostileLink:
    """Does faults to frames, and counts them; `calm(cycle)` says when it does nothing."""

    def __init__(self, seed: int, faults: Mapping[str, float], calm: Callable[[int], bool]) -> None:
        self.injected: Counter[str] = Counter()
        self._seed, self._faults, self._calm = seed, faults, calm
        self._held: dict[tuple[int, int], list[tuple[int, bytes]]] = defaultdict(list)
        self._last: dict[tuple[int, int], bytes] = {}
        self._overheard: dict[int, bytes] = {}

    def __call__(self, sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        """What arrives at a receiver when a sender sends a frame."""
        released = self._release(sender, receiver)
        before = self._last.get((sender, receiver))
        stranger = next((f for s, f in self._overheard.items() if s != sender), None)
        self._last[sender, receiver] = self._overheard[sender] = frame
        if self._calm(cycle_of(frame)):
            return (*released, frame)

        def strikes(kind: str) -> bool:
            struck = chance(self._seed, kind, sender, receiver, frame) < self._faults.get(kind, 0)
            self.injected[kind] += struck
            return struck

        def drawn(kind: str, below: int, number: int) -> int:
            return int(chance(self._seed, kind, sender, receiver, frame, number) * below)

        arrives = [frame]
        if strikes("vanish"):
            arrives = []
        elif strikes("corrupt"):
            flips = 1 + drawn("corrupt", _MOST_FLIPS, 1)
            arrives = [
                _flipped(frame, [drawn("corrupt", 8 * len(frame), 2 + f) for f in range(flips)])
            ]
        elif strikes("delay"):
            self._held[sender, receiver].append((1 + drawn("delay", _MOST_DELAY, 1), frame))
            arrives = []
        if arrives == [frame] and strikes("duplicate"):
            arrives = [frame] * (2 + drawn("duplicate", 2, 1))
        if before is not None and strikes("replay"):
            arrives.insert(0, before)
        if strikes("garbage"):
            arrives.insert(0, _garbage(frame, drawn("garbage", 5, 1), drawn("garbage", 2**16, 2)))
        if stranger is not None and strikes("spoof"):
            arrives.insert(0, stranger)
        return (*arrives, *released)

    def _release(self, sender: int, receiver: int) -> list[bytes]:
        """Frames whose delay is over: it is counted in frames that the link carries."""
        waiting = [(left - 1, frame) for left, frame in self._held.pop((sender, receiver), ())]
        self._held[sender, receiver] = [one for one in waiting if one[0] > 0]
        return [frame for left, frame in waiting if left <= 0]


def _flipped(frame: bytes, bits: Sequence[int]) -> bytes:
    """With these bits the other way; a bit that is named twice is so once."""
    broken = bytearray(frame)
    for bit in set(bits):
        broken[bit // 8] ^= 1 << bit % 8
    return bytes(broken)


def _garbage(frame: bytes, form: int, drawn: int) -> bytes:
    """Something beside a frame that no receiver may use: nothing at all, half of it, a flipped bit,
    a null frame, a counter that is not that of its cycle."""
    whole = decode(frame)
    odd = Frame(whole.frame_id, (whole.cycle_count + 1 + drawn % 63) % 64, whole.payload)
    null = Frame(whole.frame_id, whole.cycle_count, whole.payload, null=True)
    forms = (b"", frame[: drawn % len(frame)], _flipped(frame, [drawn % (8 * len(frame))]))
    return (*forms, encode(null), encode(odd))[form]
