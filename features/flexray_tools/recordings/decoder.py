"""From a recorded waveform to the frames that travelled: tolerant, and it counts what it rejects.

A receiver waits for an idle bus and takes the falling edge of TSS as the start of a frame. It sets
its clock anew at the falling edge of every byte's BSS (FlexRay protocol specification 2.1, 3.2).
"""

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.bus.flexray.cluster import BIT_RATES_MBPS
from concord.bus.flexray.cluster_parameters import Segment
from concord.bus.flexray.frame import (
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    Channel,
    Frame,
    encode,
    inspect,
)
from concord.features.flexray_tools.recordings.bitstream import (
    BitError,
    Bits,
    byte_bits,
    decode_bits,
)
from concord.features.flexray_tools.recordings.symbols import LowPulse, Symbol, symbols
from concord.features.flexray_tools.recordings.waveform import (
    Waveform,
    WaveformError,
    without_spikes,
)

# In a frame the longest high run is 9 bits, a byte of ones and a BSS; between frames CID has 11.
IDLE_BITS = 10
LONGEST_START_BITS = 16.5
SPIKE_BITS = 0.3
MAX_FRAME_BYTES = MAX_PAYLOAD_BYTES + OVERHEAD_BYTES


class DecodedFrame(NamedTuple):
    """A frame as it was recorded. `start_us` is the falling edge of TSS, `end_us` the end of FES.

    `start_sequence_us` is the length of TSS as received; `trailing_us` how long the bus was low
    after FES (DTS of a dynamic frame, or ringing). `bits` go from FSS to FES.
    """

    start_us: float
    end_us: float
    start_sequence_us: float
    trailing_us: float
    frame: Frame
    header_crc_ok: bool
    frame_crc_ok: bool
    bits: Bits

    @property
    def data(self) -> bytes:
        """The bytes from header to frame CRC, as they were recorded."""
        return decode_bits(np.append(np.uint8(0), self.bits))


class Decoding(NamedTuple):
    """All frames of a recording, in order, and what was no frame.

    `rejected` counts starts of frames that led to none, by reason (coding, truncated, too-long,
    length); `glitches` are low pulses that are neither start of a frame nor one of `symbols`. Frame
    IDs up to `static_slots` belong to the static segment.
    """

    frames: tuple[DecodedFrame, ...]
    rejected: dict[str, int]
    glitches: int
    symbols: tuple[Symbol, ...]
    bit_rate_mbps: float
    inverted: bool
    channel: Channel
    static_slots: int

    def segment(self, decoded: DecodedFrame) -> Segment:
        return "static" if decoded.frame.frame_id <= self.static_slots else "dynamic"


class _Signal(NamedTuple):
    """Level changes as plain lists, which bisect is fast on."""

    times_ns: list[int]
    levels: list[int]
    bit_ns: float

    def level(self, time_ns: float) -> int:
        return self.levels[bisect_right(self.times_ns, time_ns) - 1]


class _Found(NamedTuple):
    """Bits and bytes of a frame, and where in the recording they are."""

    start_ns: int
    end_ns: float
    start_sequence_ns: int
    trailing_ns: float
    bits: Bits
    data: bytes


class _Scan(NamedTuple):
    """Frames and pulses that a receiver of one bit rate and polarity finds in a recording."""

    bit_rate_mbps: float
    inverted: bool
    found: list[_Found]
    rejected: Counter[str]
    pulses: list[LowPulse]

    @property
    def good_headers(self) -> int:
        return sum(inspect(found.data).header_crc_ok for found in self.found)


def decode_waveform(waveform: Waveform, bit_rate_mbps: float | None = None) -> Decoding:
    """Decode a recording; finds out bit rate (unless it is given), polarity and channel by itself.

    The rate and the polarity are those with the most correct header CRCs, upright and the fastest
    rate if they are equal; the channel is told by the frame CRCs. Raises WaveformError if there is
    no frame.
    """
    if len(waveform.times_ns) < 2:
        raise WaveformError("the recording has no level change; is the probe on the bus?")
    rates = BIT_RATES_MBPS if bit_rate_mbps is None else (bit_rate_mbps,)
    best = max((_scan(waveform, rate) for rate in rates), key=_merit)
    if not best.good_headers:
        best = max((best, *(_scan(waveform, rate, inverted=True) for rate in rates)), key=_merit)
    if not best.found:
        tried = " or ".join(f"{rate:g}" for rate in rates)
        raise WaveformError(
            f"no FlexRay frame in {len(waveform.times_ns)} level changes at {tried} "
            f"Mbit/s, upright or inverted (rejected starts: {dict(best.rejected) or 'none'}); "
            "record one channel of a 10, 5 or 2.5 Mbit/s bus, from the idle bus on, and more than "
            "one frame of it"
        )
    bit_ns = 1000.0 / best.bit_rate_mbps
    correct = {
        channel: sum(inspect(found.data, channel).frame_crc_ok for found in best.found)
        for channel in ("A", "B")
    }
    channel: Channel = "B" if correct["B"] > correct["A"] else "A"
    named = symbols(best.pulses, bit_ns)
    return Decoding(
        frames=tuple(_decoded(found, channel) for found in best.found),
        rejected=dict(best.rejected),
        glitches=len(best.pulses) - sum(symbol.pulses for symbol in named),
        symbols=named,
        bit_rate_mbps=best.bit_rate_mbps,
        inverted=best.inverted,
        channel=channel,
        static_slots=_static_slots(best.found, bit_ns),
    )


def reencodes(decoded: DecodedFrame, channel: Channel) -> bool:
    """Whether encoding the frame anew gives exactly the recorded bits, FSS to FES."""
    try:
        data = encode(decoded.frame, channel)
    except ValueError:
        return False
    return np.array_equal(byte_bits(data), decoded.bits)


def _merit(scan: _Scan) -> tuple[int, int]:
    return scan.good_headers, len(scan.found)


def _scan(waveform: Waveform, bit_rate_mbps: float, inverted: bool = False) -> _Scan:
    """Try every low pulse after an idle bus as the start of a frame."""
    bit_ns = 1000.0 / bit_rate_mbps
    clean = without_spikes(waveform.inverted() if inverted else waveform, SPIKE_BITS * bit_ns)
    signal = _Signal(clean.times_ns.tolist(), clean.levels.tolist(), bit_ns)
    found: list[_Found] = []
    rejected: Counter[str] = Counter()
    pulses: list[LowPulse] = []
    index = _after_idle(signal, 0)
    while index + 1 < len(signal.times_ns):
        if not _starts_frame(signal, index):
            pulses.append(LowPulse(signal.times_ns[index], signal.times_ns[index + 1]))
            index += 2
            continue
        try:
            candidate = _receive(signal, index)
        except BitError as error:
            rejected[error.reason] += 1
            index = _after_idle(signal, index + 1)
            continue
        if len(candidate.data) == OVERHEAD_BYTES + 2 * (candidate.data[2] >> 1):
            found.append(candidate)
        else:
            rejected["length"] += 1
        index = bisect_right(signal.times_ns, candidate.end_ns + candidate.trailing_ns)
        index += signal.levels[index] if index < len(signal.times_ns) else 0
    return _Scan(bit_rate_mbps, inverted, found, rejected, pulses)


def _after_idle(signal: _Signal, index: int) -> int:
    """Index of the first falling edge, from `index` on, that ends an idle time of the bus."""
    times, levels = signal.times_ns, signal.levels
    idle_ns = IDLE_BITS * signal.bit_ns
    for later in range(max(index, 1), len(times)):
        if levels[later] == 0 and times[later] - times[later - 1] > idle_ns:
            return later
    return len(times)


def _starts_frame(signal: _Signal, index: int) -> bool:
    """Whether this falling edge begins a TSS: low for 1..15 bits, then FSS and the first BSS."""
    times = signal.times_ns
    if index + 2 >= len(times):
        return False
    low_bits = (times[index + 1] - times[index]) / signal.bit_ns
    high_bits = (times[index + 2] - times[index + 1]) / signal.bit_ns
    return 0.5 < low_bits < LONGEST_START_BITS and 1.5 < high_bits < 2.5


def _receive(signal: _Signal, index: int) -> _Found:
    """Sample the frame that begins at falling edge `index`. Raises BitError."""
    times, bit_ns = signal.times_ns, signal.bit_ns
    start, rise = times[index], times[index + 1]
    bits, fall = _sample(signal, times[index + 2])
    data = decode_bits(np.array([0, *bits], dtype=np.uint8))
    end = fall + 11 * bit_ns
    trailing = 0.0
    if signal.level(end + 0.5 * bit_ns) == 0:
        after = bisect_right(times, end + 0.5 * bit_ns)
        trailing = (times[after] if after < len(times) else times[-1]) - end
    return _Found(start, end, rise - start, trailing, np.array(bits, dtype=np.uint8), data)


def _sample(signal: _Signal, first_fall: int) -> tuple[list[int], float]:
    """Bits from FSS to FES in the middle of each, and the last BSS edge the clock was set by."""
    times, levels, bit_ns = signal.times_ns, signal.levels, signal.bit_ns
    bits = [1, 1, 0]
    fall: float = first_fall
    for _ in range(MAX_FRAME_BYTES):
        bits += [signal.level(fall + (middle + 0.5) * bit_ns) for middle in range(1, 11)]
        if bits[-2:] != [1, 0]:
            beyond = fall + 9.5 * bit_ns > times[-1]
            if beyond and bits[-2:] != [0, 1]:
                raise BitError("truncated", "the recording ends inside of a frame")
            return bits, fall
        nearest = bisect_left(times, fall + 9.5 * bit_ns)
        while nearest < len(times) and levels[nearest] == 1:
            nearest += 1
        fall = times[nearest]
    raise BitError("too-long", f"more than {MAX_FRAME_BYTES} bytes without an end sequence")


def _decoded(found: _Found, channel: Channel) -> DecodedFrame:
    frame, header_crc_ok, frame_crc_ok = inspect(found.data, channel)
    return DecodedFrame(
        start_us=found.start_ns / 1e3,
        end_us=found.end_ns / 1e3,
        start_sequence_us=found.start_sequence_ns / 1e3,
        trailing_us=found.trailing_ns / 1e3,
        frame=frame,
        header_crc_ok=header_crc_ok,
        frame_crc_ok=frame_crc_ok,
        bits=found.bits,
    )


def _static_slots(frames: Sequence[_Found], bit_ns: float) -> int:
    """The frame ID that separates the segments best: dynamic frames have a trailing sequence.

    Single static frames seem to have one when the bus rings after them; they are outvoted.
    """
    votes = [(found.data[0] & 7) << 8 | found.data[1] for found in frames]
    ids = np.array(votes)
    dynamic = np.array([found.trailing_ns > bit_ns for found in frames])
    borders = np.unique(np.append(ids, 0))
    wrong = [
        np.sum(dynamic & (ids <= border)) + np.sum(~dynamic & (ids > border)) for border in borders
    ]
    return int(borders[int(np.argmin(wrong))])
