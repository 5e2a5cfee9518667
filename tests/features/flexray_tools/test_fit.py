"""Fitting: the car's bus gives its known grid, and a simulated cluster gives itself back."""

from itertools import pairwise

import numpy as np
import pytest

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request
from concord.bus.flexray.frame import Frame, encode
from concord.bus.flexray.presets import BOSCH, FLEXRAY_ADAPTER
from concord.bus.flexray.slot_table import SlotAssignment
from concord.bus.flexray.timing import Transmission, dynamic_transmissions, static_transmissions
from concord.features.flexray_tools.recordings.decoder import Decoding, decode_waveform
from concord.features.flexray_tools.recordings.fit import fit
from concord.features.flexray_tools.recordings.waveform import Waveform
from tests.bus.support import served
from tests.features.flexray_tools.signals import encode_bits, from_bits

pytestmark = pytest.mark.slow


def test_the_recording_gives_the_known_grid(audi: Decoding):
    found = fit(audi)
    assert found.static_slots == 51
    assert found.static_slot_us == pytest.approx(52.2, abs=0.01)
    assert found.minislot_us == pytest.approx(9.0, abs=0.01)
    assert found.macrotick is not None
    assert found.macrotick.macrotick_us == pytest.approx(1.8, abs=0.001)
    assert found.macrotick[1:] == (29, 5)
    assert found.sync_ids == found.startup_ids == (8, 24, 45)
    assert found.cycles == tuple(range(28, 36))
    # Published for the same recording: starts between -0.17 and +0.38 us of their grid; where the
    # grid's zero lies between the stations is a choice, the width is not.
    assert found.start_jitter_us is not None
    early, late = found.start_jitter_us
    assert late - early == pytest.approx(0.38 + 0.17, abs=0.07)


def test_the_recording_gives_the_known_multiplexing(audi: Decoding):
    found = {entry.frame_id: entry for entry in fit(audi).multiplexing}
    claims = {i: (e.base_cycle, e.repetition) for i, e in found.items() if e.repetition}
    assert claims == {67: (0, 2), 103: (1, 2)}
    assert found[65].cycles == tuple(range(28, 36))
    # One sighting is none of eight turns.
    assert (found[83].cycles, found[83].recorded_cycles) == ((30,), 8)
    assert found[52].cycles == (28, 30, 31, 32, 33)


def test_no_part_of_the_recording_claims_what_the_whole_of_it_refutes(audi: Decoding):
    """Every run of two to eight of its cycles; halves and quarters are among them."""
    whole = {entry.frame_id: set(entry.cycles) for entry in fit(audi).multiplexing}
    for first in range(28, 35):
        for last in range(first + 1, 36):
            kept = [f for f in audi.frames if first <= f.frame.cycle_count <= last]
            for entry in fit(audi._replace(frames=tuple(kept))).multiplexing:
                assert entry.recorded_cycles == last - first + 1
                assert set(entry.cycles) == whole[entry.frame_id] & set(range(first, last + 1))
                if entry.repetition is not None:
                    turns = {c for c in range(28, 36) if c % entry.repetition == entry.base_cycle}
                    assert whole[entry.frame_id] == turns


def test_the_dynamic_slot_rule_holds_for_every_pair_of_the_recording(audi: Decoding):
    found = fit(audi)
    assert (found.dynamic_pairs_explained, found.dynamic_pairs) == (34, 34)
    # The rule written out, with the minislot of 9.0 us and not the fitted one.
    dynamic = [f for f in audi.frames if audi.segment(f) == "dynamic"]
    pairs = [
        (one, next_)
        for one, next_ in pairwise(dynamic)
        if one.frame.cycle_count == next_.frame.cycle_count
    ]
    assert len(pairs) == 34
    for one, next_ in pairs:
        bits = round(10 * one.start_sequence_us) + 1 + 10 * (8 + len(one.frame.payload)) + 2
        slots = int(np.ceil(bits * 0.1 / 9.0)) + 1
        silent = next_.frame.frame_id - one.frame.frame_id - 1
        assert next_.start_us - one.start_us == pytest.approx(9.0 * (slots + silent), abs=0.5)


def signal_of(cluster: Cluster, cycles: int, seed: int) -> tuple[Waveform, list[int]]:
    """A made recording of a cluster: some static slots, the first two sync, random requests."""
    random = np.random.default_rng(seed)
    static_ids = sorted({1, 2, cluster.static_slots, *random.integers(1, cluster.static_slots, 9)})
    sent = []
    for cycle in range(cycles):
        slots = [SlotAssignment(int(frame_id), 0) for frame_id in static_ids]
        ids = cluster.first_dynamic_id + random.choice(40, size=6, replace=False)
        sizes = 2 * random.integers(0, cluster.dynamic_payload_words + 1, 6)
        requests = [
            Request(0, int(frame_id), int(size)) for frame_id, size in zip(ids, sizes, strict=True)
        ]
        winners = served(cluster, requests)
        frames = static_transmissions(cluster, slots) + dynamic_transmissions(cluster, winners)
        for frame in frames:
            sent.append(
                (
                    1e3 * (20 + cycle * cluster.cycle_us + frame.start_us),
                    _bits(cluster, cycle, frame),
                )
            )
    return from_bits(sent, 1e3 * cluster.bit_us), [int(i) for i in static_ids]


def _bits(cluster: Cluster, cycle: int, frame: Transmission):
    sync = frame.frame_id <= 2
    content = Frame(frame.frame_id, cycle % 64, bytes(frame.payload_bytes), sync=sync, startup=sync)
    trailing = 0
    if frame.segment == "dynamic":
        # DTS ends at the first action point of a minislot that comes after the frame.
        minislot_bits = cluster.minislot_us / cluster.bit_us
        length = cluster.frame_bits(frame.payload_bytes)
        trailing = max(1, int(np.ceil(length / minislot_bits) * minislot_bits - length - 1))
    return encode_bits(encode(content), cluster.transmission_start_bits, trailing)


@pytest.mark.parametrize("cluster", [BOSCH, FLEXRAY_ADAPTER], ids=lambda cluster: cluster.name)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_simulated_cluster_gives_itself_back(cluster: Cluster, seed: int):
    signal, static_ids = signal_of(cluster, 6, seed)
    decoding = decode_waveform(signal)
    found = fit(decoding)
    assert decoding.rejected == {}
    assert found.static_slots == cluster.static_slots
    assert found.static_slot_us == pytest.approx(cluster.static_slot_us, abs=1e-3)
    assert found.minislot_us is not None
    assert found.sync_ids == (1, 2)
    static = [entry for entry in found.multiplexing if entry.segment == "static"]
    assert [entry.frame_id for entry in static] == static_ids
    assert all(len(entry.cycles) == entry.recorded_cycles == 6 for entry in static)
    if cluster.dynamic_slot_idle_phase_minislots == 0:
        assert found.minislot_us == pytest.approx(cluster.minislot_us, abs=1e-2)
        assert found.dynamic_pairs_explained == found.dynamic_pairs > 10
        assert found.macrotick is not None
        assert found.macrotick[1:] == (
            cluster.static_slot_macroticks,
            cluster.minislot_macroticks,
        )


def test_null_frames_are_no_data_of_their_slot():
    sent = [
        (
            2e4 + 5e6 * cycle + 6e4 * frame_id,
            encode_bits(encode(Frame(frame_id, cycle, bytes(4), null=cycle % frame_id > 0)), 9),
        )
        for cycle in range(16)
        for frame_id in (1, 2, 4)
    ]
    found = fit(decode_waveform(from_bits(sent, 100.0))).multiplexing
    claims = [(entry.base_cycle, entry.repetition) for entry in found]
    assert claims == [(None, None), (0, 2), (0, 4)]
    assert found[0].cycles == tuple(range(16)) and found[2].cycles == (0, 4, 8, 12)


def sightings(cycles: set[int], recorded: int):
    """Return the entry of an ID that was sent in these of so many recorded cycles."""
    sent = [
        (2e4 + 5e6 * cycle + 6e4 * frame_id, encode_bits(encode(Frame(frame_id, cycle, b"ab")), 9))
        for cycle in range(recorded)
        for frame_id in ((1, 2) if cycle in cycles else (1,))
    ]
    return fit(decode_waveform(from_bits(sent, 100.0))).multiplexing[1]


def test_two_full_periods_are_needed_and_chance_must_be_small():
    assert sightings(set(range(1, 64, 8)), 64)[-2:] == (1, 8)
    assert sightings({3, 11, 19}, 24)[-2:] == (3, 8)
    # Four cycles fit a period of two by chance as often as once in eight.
    assert sightings({0, 2}, 4)[-2:] == (None, None)
    assert sightings({5}, 15)[-2:] == (None, None)
    assert sightings({0, 2, 4, 5}, 8)[-2:] == (None, None)


def test_a_recording_that_tells_little_is_not_overread():
    frames = [(20e3, encode_bits(encode(Frame(3, 0, b"ab")), 9))]
    found = fit(decode_waveform(from_bits(frames, 100.0)))
    assert found.static_slot_us is None
    assert found.minislot_us is None
    assert found.macrotick is None
    assert found.dynamic_pairs == 0
    assert found.static_slots == 3


def test_frames_with_wrong_checksums_are_left_out(audi: Decoding):
    broken = [f._replace(frame_crc_ok=False) if i % 3 else f for i, f in enumerate(audi.frames)]
    wild = [f._replace(frame_crc_ok=False, start_us=0.0) for f in audi.frames[:40]]
    found = fit(audi._replace(frames=(*broken, *wild)))
    assert found.static_slot_us == pytest.approx(52.2, abs=0.01)
    nothing = fit(audi._replace(frames=tuple(wild)))
    assert nothing.cycles == ()
    assert nothing.static_slot_us is None
