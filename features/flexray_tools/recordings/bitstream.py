"""A frame as the sequence of bits that a transmitter drives onto the wire, and back.

TSS (low), FSS (one high bit), for every byte BSS (high, low) and its eight bits, FES (low, high); a
dynamic frame goes on with DTS (low until the next action point, one high bit). FlexRay protocol
specification 2.1, section 3.2.1. Bits are uint8 arrays of 0 and 1.
"""

import numpy as np
from numpy.typing import NDArray

from concord.bus.flexray.frame import OVERHEAD_BYTES

Bits = NDArray[np.uint8]


class BitError(ValueError):
    """Bits that are not coded as a frame. `reason` is a short code: start, coding, truncated."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


def byte_bits(data: bytes) -> Bits:
    """FSS, the bytes each with its BSS, and FES: a frame without its transmission start sequence.

    Returns 1 + 10 len(data) + 2 bits.
    """
    coded = np.empty((len(data), 10), dtype=np.uint8)
    coded[:, :2] = (1, 0)
    coded[:, 2:] = np.unpackbits(np.frombuffer(data, dtype=np.uint8)).reshape(-1, 8)
    return np.concatenate(([1], coded.ravel(), [0, 1])).astype(np.uint8)


def decode_bits(bits: Bits) -> bytes:
    """The bytes of the frame whose bits these are, from TSS to FES; what follows is not looked at.

    Raises BitError, and nothing else, for any bits.
    """
    high = np.flatnonzero(bits)
    if high.size == 0 or high[0] == 0:
        raise BitError("start", "no low start sequence followed by a high bit")
    coded = bits[high[0] + 1 :]
    pairs = len(coded) // 10
    starts = coded[: 10 * pairs].reshape(pairs, 10)[:, :2]
    begins_byte = (starts[:, 0] == 1) & (starts[:, 1] == 0)
    count = pairs if begins_byte.all() else int(np.argmin(begins_byte))
    end = coded[10 * count : 10 * count + 2]
    if len(end) < 2 or (end[0] == 1 and end[1] == 0):
        raise BitError("truncated", f"the bits end after {count} bytes, before an end sequence")
    if end[0] != 0 or end[1] != 1:
        raise BitError("coding", f"neither a byte nor the end of the frame after {count} bytes")
    if count < OVERHEAD_BYTES:
        raise BitError("truncated", f"the frame ends after {count} bytes")
    return np.packbits(coded[: 10 * count].reshape(count, 10)[:, 2:]).tobytes()
