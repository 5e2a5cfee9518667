"""Signals in the payload of a frame: their bits, and the numbers that these mean.

Bits are counted as AUTOSAR's system template and FIBEX do: bit k of byte b, from the least
significant on, is 8 b + k. A signal begins with its least significant bit where the least
significant byte comes first, and with its most significant bit where that comes last.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

MOST_BITS = 64
NumberType = Literal["unsigned", "signed", "float"]


class Coding(NamedTuple):
    """The numbers that raw bits mean: factor x raw + offset, in a unit.

    `invalid` are spans (first, last) of raw numbers that say that there is no value. Floats have 32
    or 64 bits (IEEE 754), and signed numbers are two's complements.
    """

    bits: int
    kind: NumberType = "unsigned"
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    invalid: tuple[tuple[float, float], ...] = ()


class PlacedSignal(NamedTuple):
    """A signal of a frame. Where its `update_bit` is 0, the sender has not written it anew."""

    name: str
    start_bit: int
    is_big_endian: bool
    coding: Coding
    update_bit: int | None = None

    @property
    def payload_bytes(self) -> int:
        """Shortest payload that holds it."""
        last = max(int(self._bits.max()), 0 if self.update_bit is None else self.update_bit)
        return last // 8 + 1

    @property
    def _bits(self) -> NDArray[np.int64]:
        """The places of its bits, the least significant first."""
        count = np.arange(self.coding.bits)
        if not self.is_big_endian:
            return self.start_bit + count
        # In the order of transmission the bits of a byte go from 7 to 0.
        first = self.start_bit ^ 7
        return ((first + self.coding.bits - 1) - count) ^ 7

    def raw(self, payloads: NDArray[np.uint8]) -> NDArray[np.uint64]:
        """Return the raw bits (n,) in payloads (n, bytes)."""
        places = self._bits
        bits = payloads[:, places // 8] >> (places % 8).astype(np.uint8) & 1
        return (bits.astype(np.uint64) << np.arange(len(places), dtype=np.uint64)).sum(
            axis=1, dtype=np.uint64
        )

    def is_new(self, payloads: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return where (n,) in payloads (n, bytes) the sender has written it anew."""
        if self.update_bit is None:
            return np.ones(len(payloads), dtype=bool)
        return (payloads[:, self.update_bit // 8] >> self.update_bit % 8 & 1).astype(bool)

    def values(self, payloads: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the numbers (n,) in payloads (n, bytes), NaN for one that is not valid."""
        coding, raw = self.coding, self.raw(payloads)
        if coding.kind == "float":
            whole = raw.astype(np.uint32).view(np.float32) if coding.bits == 32 else raw.view(float)
            # A NaN may be one that signals.
            with np.errstate(invalid="ignore"):
                numbers = whole.astype(float)
        elif coding.kind == "signed":
            unused = np.uint64(MOST_BITS - coding.bits)
            numbers = ((raw << unused).view(np.int64) >> unused.astype(np.int64)).astype(float)
        else:
            numbers = raw.astype(float)
        missing = np.zeros(len(raw), dtype=bool)
        for first, last in coding.invalid:
            missing |= (numbers >= first) & (numbers <= last)
        return np.where(missing, np.nan, coding.factor * numbers + coding.offset)


class FrameSignals(NamedTuple):
    """The signals of a frame, and the slot and the cycles in which it is sent."""

    name: str
    frame_id: int
    base_cycle: int
    repetition: int
    channels: str
    signals: tuple[PlacedSignal, ...]


class DescribedSignals(NamedTuple):
    """The frames with signals of a description, and why others of its signals are left out."""

    frames: tuple[FrameSignals, ...]
    left_out: dict[str, str]
