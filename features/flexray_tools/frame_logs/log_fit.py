"""The cluster and the slots behind a log of frames, as far as frames tell them."""

from typing import NamedTuple, cast

import numpy as np

from concord.bus.flexray.cluster import BIT_RATES_MBPS, Cluster
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.frame import OVERHEAD_BYTES, Channel
from concord.features.flexray_tools.frame_logs.frames import (
    FrameBlock,
    FrameLogError,
    channel_name,
    frame_of,
)
from concord.features.flexray_tools.frame_logs.log_files import FrameLog, Stamps, first_frames
from concord.features.flexray_tools.frame_logs.tally import (
    FrameStatistics,
    LogTally,
    static_border,
    tallied,
)
from concord.features.flexray_tools.recordings.decoder import DecodedFrame, Decoding
from concord.features.flexray_tools.recordings.fit import Fit, fit
from concord.features.flexray_tools.recordings.multiplexing import Multiplex, multiplex

SAMPLE_FRAMES = 20_000
"""Times are fitted to the first frames of a log."""
_SAMPLE_CYCLES = 64
ASSUMED_RATE_MBPS = 10.0
ASSUMED_START_BITS = 9
ONLY_A_WAVEFORM = ("bit_rate_mbps", "transmission_start_bits")
"""Parameters of a cluster that a waveform tells, and a log of frames does not."""
_NO_BITS = np.zeros(0, dtype=np.uint8)


class FittedLog(NamedTuple):
    """The counts of a log, the fit of the channel with most frames, and the multiplexing
    of each channel. `decoding` has the first frames of that channel."""

    tally: LogTally
    decoding: Decoding
    fit: Fit
    multiplexing: dict[Channel, tuple[Multiplex, ...]]


def fit_log(
    log: FrameLog,
    bit_rate_mbps: float | None = None,
    static_slots: int | None = None,
    stamps: Stamps = "start",
) -> FittedLog:
    """Fit a cluster to a log.

    Args:
        log: the log.
        bit_rate_mbps: of the bus, which frames do not tell; 10 otherwise.
        static_slots: number of static slots, where it is known.
        stamps: whether times are those of the first or the last bit of a frame.

    Raises:
        FrameLogError: the log cannot be read, or has no cycles.
    """
    if bit_rate_mbps not in (None, *BIT_RATES_MBPS):
        raise FrameLogError(f"--bit-rate {bit_rate_mbps:g}: FlexRay has 10, 5 and 2.5 Mbit/s")
    sample = first_frames(log, SAMPLE_FRAMES)
    tally = tallied(log.blocks(), sample)
    try:
        border = static_border(tally, sample) if static_slots is None else static_slots
    except FrameLogError as error:
        raise FrameLogError(f"{log.path}: {error}") from None
    counts = {number: sum(r.frames for r in tally.rows if r.channel == number) for number in (0, 1)}
    channel = channel_name(max(counts, key=lambda number: counts[number]))
    rate = bit_rate_mbps or ASSUMED_RATE_MBPS
    decoding = _sampled(sample, channel, rate, border, stamps)
    fitted = fit(decoding)
    found: dict[Channel, tuple[Multiplex, ...]] = {
        channel_name(number): tuple(
            _multiplex(one, tally, border) for one in tally.rows if one.channel == number
        )
        for number in (0, 1)
        if counts[number]
    }
    flags = [row for row in tally.rows if channel_name(row.channel) == channel]
    fitted = fitted._replace(
        cycles=tuple(np.flatnonzero(tally.recorded).tolist()),
        sync_ids=tuple(row.frame_id for row in flags if row.flags & 2),
        startup_ids=tuple(row.frame_id for row in flags if row.flags & 4),
        multiplexing=found[channel],
    )
    return FittedLog(tally, decoding, fitted, found)


def _multiplex(one: FrameStatistics, tally: LogTally, border: int) -> Multiplex:
    recorded = {int(c): int(tally.recorded[c]) for c in np.flatnonzero(tally.recorded)}
    seen = set(np.flatnonzero(one.data).tolist())
    return multiplex(one.frame_id, seen, recorded, border)


def _sampled(
    sample: FrameBlock, channel: Channel, rate: float, border: int, stamps: Stamps
) -> Decoding:
    """Return the frames of the first cycles of one channel as if they had been decoded."""
    some = sample.of(sample.channel == (channel == "B"))
    changes = np.flatnonzero(some.cycle[1:] != some.cycle[:-1]) + 1
    if len(changes) >= _SAMPLE_CYCLES:
        some = some.of(np.arange(int(changes[_SAMPLE_CYCLES - 1])))
    sure = some.sure
    frames: list[DecodedFrame] = []
    for row, right in zip(some.rows(), sure.tolist(), strict=True):
        time_ns, _, frame_id, cycle, flags, payload = row
        bits = ASSUMED_START_BITS + 1 + 2 + 10 * (OVERHEAD_BYTES + len(payload))
        start_us = time_ns / 1e3 - (bits / rate if stamps == "end" else 0.0)
        frames.append(
            DecodedFrame(
                start_us=start_us,
                end_us=start_us + bits / rate,
                start_sequence_us=ASSUMED_START_BITS / rate,
                trailing_us=0.0,
                frame=frame_of(frame_id, cycle, flags, payload),
                header_crc_ok=right,
                frame_crc_ok=right,
                bits=_NO_BITS,
            )
        )
    return Decoding(tuple(frames), {}, 0, (), rate, False, channel, border)


def log_slots(
    tally: LogTally, border: int, cluster: Cluster | None = None
) -> tuple[MessageSlot, ...]:
    """Return a slot for each frame ID of a log, with the multiplexing that the log proves.

    A log does not name senders: every frame ID gets a node of its own. A frame that is the same on
    both channels is one slot. A dynamic frame that comes less often than in its cycles has the
    shortest period that the log shows, in whole cycles of the cluster.
    """
    proved = {
        (one.channel, one.frame_id): _multiplex(one, tally, border)
        for one in tally.rows
        if one.frames
    }
    ids = sorted({frame_id for _, frame_id in proved})
    found: list[MessageSlot] = []
    rows = {(one.channel, one.frame_id): one for one in tally.rows}
    for node, frame_id in enumerate(ids):
        there = [c for c in (0, 1) if (c, frame_id) in proved]
        claims = [_claim(proved[c, frame_id]) for c in there]
        if len(there) == 2 and claims[0] == claims[1]:
            there, claims = [there], claims[:1]
        else:
            there = [[c] for c in there]
        for channels, (base, repetition) in zip(there, claims, strict=True):
            of_slot = [rows[c, frame_id] for c in channels]
            found.append(
                MessageSlot(
                    frame_id=frame_id,
                    payload_bytes=_even(max(one.payload_bytes[1] for one in of_slot)),
                    node=node,
                    channel=cast(Channels, "".join(map(channel_name, channels))),
                    base_cycle=base,
                    repetition=repetition,
                    period_us=_period_us(of_slot[0], repetition, border, cluster),
                )
            )
    return tuple(found)


def _claim(one: Multiplex) -> tuple[int, int]:
    return (one.base_cycle or 0, one.repetition) if one.repetition else (0, 1)


def _even(size: int) -> int:
    return size + size % 2


def _period_us(
    one: FrameStatistics, repetition: int, border: int, cluster: Cluster | None
) -> float | None:
    if one.frame_id <= border or one.gap_us is None or cluster is None:
        return None
    cycles = round(one.gap_us[0] / cluster.cycle_us)
    return cycles * cluster.cycle_us if cycles > repetition else None
