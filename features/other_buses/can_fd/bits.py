"""CAN FD frames bit by bit: stuff bits, stuff count, checksum, and how long frames last.

Source: ISO 11898-1:2015, clauses 10.4 and 10.5; Bosch, CAN with flexible data-rate 1.0 (2012).
"""

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

DATA_BYTES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""The data bytes of each data length code."""
BASE_BITS, EXTENDED_BITS = 11, 29
IDENTIFIER_BITS = {"base": BASE_BITS, "extended": EXTENDED_BITS}
"""Bits of an identifier by the name of its format."""
_LONGEST_WITH_CRC_17 = 16
# Generators without their leading one: (width, generator).
_CRC_17, _CRC_21 = (17, 0x1685B), (21, 0x102899)
_COUNT_BITS = 4
_FIXED_STUFF_EVERY = 4
# CRC delimiter, acknowledge slot and delimiter, end of frame; then the intermission.
_END_BITS, INTERMISSION_BITS = 10, 3
# An error flag with its superposition, at most 12 bits, and a delimiter of 8 bits (10.7).
ERROR_FRAME_BITS = 20
_RUN = 5


class Rates(NamedTuple):
    """Bits of an identifier, and the bit rates of arbitration and of data."""

    identifier_bits: int = EXTENDED_BITS
    nominal_kbit_s: int = 500
    data_kbit_s: int = 2000

    def us(self, bits: "FrameBits") -> Fraction:
        """Return the time of so many bits."""
        return Fraction(1000 * bits.nominal, self.nominal_kbit_s) + Fraction(
            1000 * bits.data, self.data_kbit_s
        )


class FrameBits(NamedTuple):
    """Bits of a frame at the nominal rate and at the data rate, without intermission.

    Bit rate switch and CRC delimiter, in which the rate changes, count at the nominal rate.
    """

    nominal: int
    data: int


class FrameOnWire(NamedTuple):
    """A frame bit by bit.

    Attributes:
        stuffed: the bits up to the CRC field, with stuff bits.
        arbitration_bits: how many of these are sent at the nominal rate.
        stuff_bits: how many of these are stuff bits.
        stuff_count: of the CRC field, with its parity.
        crc: the checksum.
    """

    stuffed: str
    arbitration_bits: int
    stuff_bits: int
    stuff_count: int
    crc: int


def padded(size: int) -> int:
    """Return the least data length of CAN FD that holds so many bytes.

    Above 64 it returns the size itself, which no frame holds.
    """
    return next((length for length in DATA_BYTES if length >= size), size)


def head_bits(identifier: int, identifier_bits: int) -> str:
    """Return the bits from start of frame to bit rate switch."""
    if identifier_bits == BASE_BITS:
        # Start, identifier; RRS, IDE, FDF, res, BRS.
        return f"0{identifier:011b}00101"
    high, low = divmod(identifier, 1 << 18)
    # Start, 11 bits, SRR and IDE, 18 bits; RRS, FDF, res, BRS.
    return f"0{high:011b}11{low:018b}0101"


@lru_cache(4096)
def wire(identifier: int, identifier_bits: int, data: bytes) -> FrameOnWire:
    """Return the bits of an error-active frame and its checksum. `data` has a length of CAN FD."""
    head = head_bits(identifier, identifier_bits)
    body = f"0{DATA_BYTES.index(len(data)):04b}" + "".join(f"{byte:08b}" for byte in data)
    stuffed, arbitration_bits = stuff(head + body, len(head))
    stuff_bits = len(stuffed) - len(head) - len(body)
    count = stuff_count(stuff_bits)
    width, generator = crc_of(len(data))
    crc = checksum(f"{stuffed}{count:04b}", width, generator, 1 << width - 1)
    return FrameOnWire(stuffed, arbitration_bits, stuff_bits, count, crc)


def stuff(bits: str, head: int) -> tuple[str, int]:
    """Return the bits with a stuff bit after five equal ones, and how many begin before bit `head`.

    The fixed stuff bit of the CRC field takes the place of one after the last bit.
    """
    found: list[str] = []
    last, run, of_head = "", 0, 0
    for place, bit in enumerate(bits):
        if run == _RUN:
            last, run = ("1" if last == "0" else "0"), 1
            found.append(last)
        of_head = len(found) if place == head else of_head
        run = run + 1 if bit == last else 1
        last = bit
        found.append(bit)
    return "".join(found), of_head


def stuff_count(stuff_bits: int) -> int:
    """Return the stuff count: stuff bits modulo 8 as Gray code, then a bit of even parity."""
    number = stuff_bits % 8
    gray = number ^ number >> 1
    return gray << 1 | gray.bit_count() % 2


def crc_of(size: int) -> tuple[int, int]:
    """Return width and generator of the checksum of frames with so many data bytes."""
    return _CRC_17 if size <= _LONGEST_WITH_CRC_17 else _CRC_21


def checksum(bits: str, width: int, generator: int, initial: int) -> int:
    """Return the CRC of a text of 0 and 1."""
    register, top, mask = initial, 1 << width - 1, (1 << width) - 1
    for bit in bits:
        feedback = (register & top != 0) ^ (bit == "1")
        register = register << 1 & mask
        if feedback:
            register ^= generator
    return register


def longest_bits(identifier_bits: int, size: int) -> FrameBits:
    """Return the bits of a frame with the most stuff bits: one in four after the first bit."""
    head = len(head_bits(0, identifier_bits))
    behind = 5 + 8 * size
    of_head, of_all = (head - 1) // 4, (head + behind - 1) // 4
    return FrameBits(head + of_head + _END_BITS, behind + of_all - of_head + _crc_field_bits(size))


def _crc_field_bits(size: int) -> int:
    """Stuff count, CRC, and a fixed stuff bit before and after every fourth bit of them."""
    bits = _COUNT_BITS + crc_of(size)[0]
    return bits + 1 + bits // _FIXED_STUFF_EVERY
