"""What a network does below the vocabulary of faults while a case of torture lasts.

The words of docs/faults.md happen to frames that have come, at the receiver, so that nobody waits
for what is lost. What no word says is what comes without a sender having sent it in that moment,
what never comes at all, and in which order messages come. That is the wire's: a kind and a
probability, "garbage 0.2". The fate of a frame is a hash of the seed, the kind, sender, receiver,
cycle and number of the frame, so that taking one kind away leaves all others as they were.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from bus.frame import Frame, decode, encode
from nodes import in_process
from nodes.share import cycle_of

WIRE_FAULTS = ("vanish", "garbage", "shuffle")
# Of these a frame can be missed; the others change no bit of any estimate.
LOSING = ("vanish",)

_DRAWN = struct.Struct("<QHHIB")
_SEQUENCE = 2


def _chance(
    seed: int, kind: str, sender: int, receiver: int, frame: bytes, number: int = 0
) -> float:
    """A number in [0, 1) that belongs to a frame on its way, and to what is asked of it."""
    identity = int.from_bytes(frame[:2], "big") % 2048
    where = _DRAWN.pack(seed, sender, receiver, cycle_of(frame), number)
    digest = hashlib.blake2b(where, digest_size=8, person=kind.encode(), salt=b"%d" % identity)
    return int.from_bytes(digest.digest(), "big") / 2**64


def read_wire(words: Sequence[str]) -> dict[str, float]:
    """Kinds and their probabilities.

    Raises:
        ValueError: a word that is no fault of the wire, or a probability that is none.
    """
    faults = {}
    for word in words:
        kind, _, text = word.strip().partition(" ")
        try:
            faults[kind] = float(text)
        except ValueError:
            faults[kind] = float("nan")
        if kind not in WIRE_FAULTS or not 0 <= faults[kind] <= 1:
            raise ValueError(
                f"--wire {word!r}: must be a kind and a probability, as in 'garbage 0.2'; kinds "
                f"are {', '.join(WIRE_FAULTS)}; all other faults are words of --changes"
            )
    return faults


class Wire:
    """Does faults to what travels, and counts them; `calm(cycle)` says when it does nothing."""

    def __init__(self, seed: int, faults: Mapping[str, float], calm: Callable[[int], bool]) -> None:
        self.injected: Counter[str] = Counter()
        self._seed, self._faults, self._calm = seed, faults, calm
        self._last: dict[tuple[int, int], bytes] = {}
        self._overheard: dict[int, bytes] = {}
        self._order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, _SEQUENCE)))

    @property
    def pick(self) -> in_process.Pick:
        """Which message comes next: mostly the oldest, with a probability any."""
        return self._pick if self._faults.get("shuffle") else in_process.first_come

    def _pick(self, waiting: int) -> int:
        if waiting == 1 or self._order.random() >= self._faults["shuffle"]:
            return 0
        place = int(self._order.integers(waiting))
        self.injected["shuffle"] += place > 0
        return place

    def carry(self, sender: int, receiver: int, frame: bytes) -> Iterable[bytes]:
        """What arrives at a receiver when a sender sends a frame."""
        before = self._last.get((sender, receiver), b"")
        stranger = next((f for s, f in self._overheard.items() if s != sender), b"")
        self._last[sender, receiver] = self._overheard[sender] = frame
        if self._calm(cycle_of(frame)):
            return (frame,)

        def strikes(kind: str) -> bool:
            struck = _chance(self._seed, kind, sender, receiver, frame) < self._faults.get(kind, 0)
            self.injected[kind] += struck
            return struck

        def drawn(below: int, number: int) -> int:
            return int(_chance(self._seed, "garbage", sender, receiver, frame, number) * below)

        arrives = [] if strikes("vanish") else [frame]
        if strikes("garbage"):
            forms = _garbage(frame, before, stranger, drawn(2**16, 2))
            arrives.insert(drawn(2, 3), forms[drawn(len(forms), 1)])
        return arrives


def _garbage(frame: bytes, before: bytes, stranger: bytes, drawn: int) -> tuple[bytes, ...]:
    """What a receiver may not use: nothing at all, half of a frame, a flipped bit, a null frame, a
    counter that is not that of its cycle; the same frame once more, the one that the sender has
    sent before it, and one that somebody else has sent."""
    whole = decode(frame)
    odd = Frame(whole.frame_id, (whole.cycle_count + 1 + drawn % 63) % 64, whole.payload)
    null = Frame(whole.frame_id, whole.cycle_count, whole.payload, null=True)
    flipped = bytearray(frame)
    flipped[drawn % len(frame)] ^= 1 << drawn % 8
    half = frame[: drawn % len(frame)]
    return (b"", half, bytes(flipped), encode(null), encode(odd), frame, before, stranger)
