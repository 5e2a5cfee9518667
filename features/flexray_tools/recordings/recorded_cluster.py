"""A cluster made of what a recording shows; the rest is chosen, and said to be chosen."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from concord.bus.flexray.clock_constraints import offset_correction_macroticks
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.bus.flexray.levels import precision_us
from concord.features.flexray_tools.recordings.decoder import DecodedFrame, Decoding
from concord.features.flexray_tools.recordings.fit import Fit
from concord.features.flexray_tools.recordings.waveform import WaveformError

_LONGEST_PAYLOAD_WORDS = 127
_CYCLE_SPREAD = 0.01
CHOSEN = (
    "microtick_us",
    "microticks_per_cycle",
    "action_point_macroticks",
    "minislots",
    "minislot_action_point_macroticks",
    "dynamic_payload_words",
    "latest_transmission_minislot",
    "symbol_window_macroticks",
    "network_idle_time_macroticks",
)
"""Fields that no recording of frames shows: the longest frames and most minislots that fit."""


class RecordedCluster(NamedTuple):
    """A cluster, and which of its fields were chosen."""

    cluster: Cluster
    chosen: tuple[str, ...]


def recorded_cluster(
    decoding: Decoding, fitted: Fit, name: str, cycle_us: float | None = None
) -> RecordedCluster:
    """Make the cluster of a recording.

    `cycle_us` is the length of a cycle; without it the starts of equal frame IDs tell it.

    Raises:
        WaveformError: the recording shows no macrotick, or cycles of very different lengths.
        ClusterError: the figures fit no cluster.
    """
    if fitted.macrotick is None:
        raise WaveformError(
            "the recording has too few static or dynamic frames to tell slot, minislot and "
            "macrotick; record more cycles"
        )
    known = cycle_us is not None
    if cycle_us is None:
        cycle_us = _cycle_us(decoding)
    frames = [frame for frame in decoding.frames if frame.header_crc_ok and frame.frame_crc_ok]
    static = [frame for frame in frames if decoding.segment(frame) == "static"]
    payloads = [len(frame.frame.payload) // 2 for frame in frames]
    bits = [frame.start_sequence_us * decoding.bit_rate_mbps for frame in frames]
    macroticks = round(cycle_us / fitted.macrotick.macrotick_us)
    microtick_us = 0.05 if decoding.bit_rate_mbps < 5 else 0.025
    enough = len(fitted.startup_ids) >= 2
    fields: dict[str, Any] = {
        "name": name,
        "channels": decoding.channel,
        "bit_rate_mbps": decoding.bit_rate_mbps,
        "cycle_us": cycle_us,
        "macroticks_per_cycle": macroticks,
        "macrotick_us": cycle_us / macroticks,
        "microtick_us": microtick_us,
        "microticks_per_cycle": round(cycle_us / microtick_us),
        "static_slots": fitted.static_slots,
        "static_slot_macroticks": fitted.macrotick.static_slot_macroticks,
        "static_payload_words": max(len(frame.frame.payload) // 2 for frame in static),
        "minislot_macroticks": fitted.macrotick.minislot_macroticks,
        # Stars shorten a start sequence, so the longer ones tell what was sent.
        "transmission_start_bits": min(15, round(float(np.quantile(bits, 0.75)))),
        "sync_slots": fitted.sync_ids if enough else (),
        "startup_slots": fitted.startup_ids if enough else (),
    }
    cluster = _with_room(fields, max(payloads))
    return RecordedCluster(cluster, CHOSEN + (("cycle_us",) if known else ()))


def _with_room(fields: dict[str, Any], longest_words: int) -> Cluster:
    """The cluster with the widest action points, most minislots and longest frames that fit."""
    slot, minislot = fields["static_slot_macroticks"], fields["minislot_macroticks"]
    static = fields["static_slots"] * slot
    # A cluster without minislots tells what its frames need.
    bare = Cluster(
        **fields
        | {
            "action_point_macroticks": 1,
            "minislots": 0,
            "minislot_action_point_macroticks": 1,
            "dynamic_payload_words": longest_words,
            "latest_transmission_minislot": 0,
            "network_idle_time_macroticks": fields["macroticks_per_cycle"] - static,
        }
    )
    offset = 1 + (slot - bare.static_frame_macroticks(bare.static_payload_bytes)) // 2
    minislot_offset = max(1, min(offset, minislot - 2))
    idle = 1 + offset_correction_macroticks(bare, precision_us(bare))
    free = bare.macroticks_per_cycle - static - max(0, offset - minislot_offset)
    minislots = max(0, (free - idle) // minislot)
    words = max(
        (
            words
            for words in range(longest_words, _LONGEST_PAYLOAD_WORDS + 1)
            if bare.dynamic_slot_most_minislots(2 * words) <= minislots
        ),
        default=longest_words,
    )
    longest = bare.dynamic_slot_most_minislots(2 * words)
    return Cluster(
        **fields
        | {
            "action_point_macroticks": offset,
            "minislots": minislots,
            "minislot_action_point_macroticks": minislot_offset,
            "dynamic_payload_words": words,
            "latest_transmission_minislot": max(0, minislots - longest + 1),
            "network_idle_time_macroticks": free - minislots * minislot,
        }
    )


def _cycle_us(decoding: Decoding) -> float:
    """Time between the starts of a static frame in consecutive cycles, to a tenth of a us."""
    gaps = [
        later.start_us - earlier.start_us
        for frames in _by_id(decoding).values()
        for earlier, later in pairwise(frames)
        if (later.frame.cycle_count - earlier.frame.cycle_count) % 64 == 1
    ]
    if not gaps:
        raise WaveformError(
            "the recording has no two consecutive cycles, so it does not show how long a cycle "
            "is; state it with --cycle-us"
        )
    middle = float(np.median(gaps))
    if max(gaps) - min(gaps) > _CYCLE_SPREAD * middle:
        raise WaveformError(
            f"cycles of the recording begin {min(gaps):.1f} to {max(gaps):.1f} us apart, so its "
            "idle times are not true; state the length of a cycle with --cycle-us"
        )
    return round(middle, 1)


def _by_id(decoding: Decoding) -> dict[int, Sequence[DecodedFrame]]:
    frames: dict[int, list[DecodedFrame]] = {}
    for decoded in decoding.frames:
        sure = decoded.header_crc_ok and decoded.frame_crc_ok
        if sure and decoding.segment(decoded) == "static":
            frames.setdefault(decoded.frame.frame_id, []).append(decoded)
    return dict(frames)


def recorded_slots(decoding: Decoding, fitted: Fit) -> tuple[MessageSlot, ...]:
    """Return a slot for each frame ID that a recording shows, with the multiplexing it proves.

    A recording does not name senders: every slot gets a node of its own, in order of IDs.
    """
    longest: dict[int, int] = {}
    for decoded in decoding.frames:
        if decoded.header_crc_ok and decoded.frame_crc_ok:
            frame = decoded.frame
            longest[frame.frame_id] = max(longest.get(frame.frame_id, 0), len(frame.payload))
    claims = {entry.frame_id: entry for entry in fitted.multiplexing if entry.repetition}
    return tuple(
        MessageSlot(
            frame_id=frame_id,
            payload_bytes=longest[frame_id],
            node=node,
            channel=decoding.channel,
            base_cycle=claims[frame_id].base_cycle or 0 if frame_id in claims else 0,
            repetition=claims[frame_id].repetition or 1 if frame_id in claims else 1,
        )
        for node, frame_id in enumerate(sorted(longest))
    )
