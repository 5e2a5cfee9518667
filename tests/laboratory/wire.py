"""Transport faults that no fault word describes, for a case of simulation testing.

The words of docs/faults.md affect frames that have arrived, at the receiver, so no process waits
for a lost frame. No word describes frames that no sender sent at that moment, frames that never
arrive, and the order of messages. The wire produces these faults; each is given by a kind and a
probability, "garbage 0.2". The outcome of a frame is a hash of seed, kind, sender, receiver, cycle
and frame number. So the removal of one kind leaves all others unchanged.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from concord.bus.bus import Fragment, FrameFormat
from concord.runtime import in_process

WIRE_FAULTS = ("vanish", "garbage", "shuffle")
# Of these a frame can be missed; the others change no bit of any estimate.
LOSING = ("vanish",)

_DRAWN = struct.Struct("<QHHIB")
_SEQUENCE = 2


def _chance(
    seed: int, kind: str, sender: int, receiver: int, fragment: Fragment, number: int = 0
) -> float:
    """A number in [0, 1) that belongs to a frame on its way, and to what is asked of it."""
    identity = fragment.frame_id
    where = _DRAWN.pack(seed, sender, receiver, fragment.cycle, number)
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

    def __init__(
        self,
        seed: int,
        faults: Mapping[str, float],
        calm: Callable[[int], bool],
        frame_format: FrameFormat,
    ) -> None:
        self._frames = frame_format
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
        """Return the frames that arrive at a receiver when a sender sends a frame."""
        before = self._last.get((sender, receiver), b"")
        stranger = next((f for s, f in self._overheard.items() if s != sender), b"")
        self._last[sender, receiver] = self._overheard[sender] = frame
        fragment = self._frames.read(frame)
        if self._calm(fragment.cycle):
            return (frame,)

        def strikes(kind: str) -> bool:
            struck = _chance(self._seed, kind, sender, receiver, fragment) < self._faults.get(
                kind, 0
            )
            self.injected[kind] += struck
            return struck

        def drawn(below: int, number: int) -> int:
            return int(_chance(self._seed, "garbage", sender, receiver, fragment, number) * below)

        arrives = [] if strikes("vanish") else [frame]
        if strikes("garbage"):
            forms = _garbage(self._frames, frame, before, stranger, drawn(2**16, 2))
            arrives.insert(drawn(2, 3), forms[drawn(len(forms), 1)])
        return arrives


def _garbage(
    form: FrameFormat, frame: bytes, before: bytes, stranger: bytes, drawn: int
) -> tuple[bytes, ...]:
    """Return frames that a receiver must not use.

    They are an empty frame, half of a frame, a flipped bit, a null frame and a frame with the
    counter of another cycle. They are also the same frame again, the sender's previous frame, and a
    frame of another sender.
    """
    odd = form.miscounted(frame, 1 + drawn % 63)
    flipped = bytearray(frame)
    flipped[drawn % len(frame)] ^= 1 << drawn % 8
    half = frame[: drawn % len(frame)]
    return (b"", half, bytes(flipped), form.emptied(frame), odd, frame, before, stranger)
