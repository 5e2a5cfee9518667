"""Signals of frames as a sender makes them, for tests of what reads them."""

from collections.abc import Iterable

import numpy as np

from concord.features.flexray_tools.recordings.bitstream import Bits, byte_bits
from concord.features.flexray_tools.recordings.waveform import Waveform, from_samples


def encode_bits(data: bytes, transmission_start_bits: int, trailing_low_bits: int = 0) -> Bits:
    """The bits of a frame on the wire. `trailing_low_bits` > 0 adds a DTS of so many low bits.

    Raises ValueError for a start sequence outside of 1..15 bits.
    """
    if not 1 <= transmission_start_bits <= 15:
        raise ValueError(
            f"a transmission start sequence of {transmission_start_bits} bits; it has 1..15"
        )
    start = np.zeros(transmission_start_bits, dtype=np.uint8)
    trail = [0] * trailing_low_bits + [1] if trailing_low_bits else []
    return np.concatenate((start, byte_bits(data), trail)).astype(np.uint8)


def from_bits(transmissions: Iterable[tuple[float, Bits]], bit_ns: float) -> Waveform:
    """The signal of frames: each a start time in ns and its bits (`encode_bits`).

    The bus is idle (high) before, between and after them. Raises WaveformError if they overlap.
    """
    times: list[int] = [0]
    levels: list[int] = [1]
    for start_ns, bits in sorted(transmissions, key=lambda transmission: transmission[0]):
        edges = np.flatnonzero(np.diff(bits, prepend=1)).tolist()
        for edge in edges:
            times.append(round(start_ns + edge * bit_ns))
            levels.append(int(bits[edge]))
        times.append(round(start_ns + len(bits) * bit_ns))
        levels.append(1)
    return from_samples(times, levels)


def format_waveform(waveform: Waveform) -> str:
    """The CSV text of a waveform."""
    rows = zip(waveform.times_ns.tolist(), waveform.levels.tolist(), strict=True)
    return "time_ns,level\n" + "".join(f"{time},{level}\n" for time, level in rows)
