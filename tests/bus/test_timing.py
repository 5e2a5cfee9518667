"""Times of frames: within their slots, in order, and refused when a step has no time for them."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import Request
from concord.bus.flexray.presets import AUDI, DEMO
from concord.bus.flexray.slot_table import SlotAssignment
from concord.bus.flexray.timing import (
    TimingError,
    bus_load,
    check_timing,
    dynamic_transmissions,
    fusion_delay_us,
    segments,
    static_transmissions,
    stretch_needed,
)
from tests.bus.support import clusters, dynamic_segments, quick, served


@quick
@given(dynamic_segments(), st.data())
def test_frames_lie_in_their_segments_and_apart(segment, data):
    cluster, requests = segment
    owned = data.draw(st.sets(st.integers(1, cluster.static_slots)))
    slots = [SlotAssignment(frame_id, 0, cluster.channels) for frame_id in sorted(owned)]
    winners = served(cluster, requests)
    static = static_transmissions(cluster, slots)
    dynamic = dynamic_transmissions(cluster, winners)
    places = {part.name: part for part in segments(cluster)}
    end_us = 0.0
    for frame in static + dynamic:
        # Receivers see the end of a frame when the bus has been idle for 11 bits.
        assert frame.start_us >= end_us
        end_us = frame.end_us + 11 * cluster.bit_us
        place = places[frame.segment]
        assert place.start_us - 1e-9 <= frame.start_us
        assert frame.end_us <= place.end_us + 1e-9
        bits = cluster.transmission_start_bits + 3 + 10 * (8 + frame.payload_bytes)
        assert frame.end_us - frame.start_us == pytest.approx(bits * cluster.bit_us)
    for channel in cluster.channels:
        assert 0 <= bus_load(cluster, static + dynamic, channel) < 1


@quick
@given(clusters())
def test_segments_tile_the_cycle(cluster: Cluster):
    parts = segments(cluster)
    assert parts[0].start_us == 0
    assert parts[-1].end_us == pytest.approx(cluster.cycle_us)
    assert all(a.end_us == b.start_us for a, b in pairwise(parts))


def test_a_known_cycle_by_hand():
    (static,) = static_transmissions(DEMO, [SlotAssignment(3, 7)])
    assert (static.start_us, static.end_us) == pytest.approx((2 * 272 + 3, 547 + 263.2))
    first, second = dynamic_transmissions(DEMO, [Request(1, 23, 0), Request(2, 25, 254)])
    # Two silent slots, then 9.2 us in 2 + 1 minislots, one silent slot, then minislot 7.
    assert (first.minislot, second.minislot) == (3, 7)
    assert first.start_us == pytest.approx(20 * 272 + 2 * 8 + 3)
    assert second.start_us == pytest.approx(20 * 272 + 6 * 8 + 3)
    assert second.end_us == pytest.approx(second.start_us + 263.2)
    assert bus_load(DEMO, [static, first, second]) == pytest.approx((263.2 * 2 + 9.2) / 10000)
    assert bus_load(DEMO, [static, first, second], "B") == 0
    assert fusion_delay_us(DEMO, 3, [static, second]) == pytest.approx(20000 + second.end_us)


def test_frames_without_room_are_not_on_the_bus():
    asked = [Request(i, 21 + i, 254) for i in range(17)]
    frames = dynamic_transmissions(DEMO, asked)
    assert [frame.frame_id for frame in frames] == list(range(21, 37))
    assert frames[-1].end_us <= segments(DEMO)[-2].end_us
    assert dynamic_transmissions(DEMO, asked[:16]) == frames


@quick
@given(st.integers(1, 20), st.floats(1e-3, 10.0), st.floats(1.0, 50.0))
def test_a_step_is_refused_exactly_if_its_cycles_last_longer(rounds, time_step_s, stretch):
    fits = rounds * 0.01 <= time_step_s * stretch * (1 + 1e-12) + 1e-12
    if fits:
        check_timing(DEMO, rounds, time_step_s, stretch)
        return
    with pytest.raises(TimingError):
        check_timing(DEMO, rounds, time_step_s, stretch)
    needed = stretch_needed(DEMO, rounds, time_step_s)
    check_timing(DEMO, rounds, time_step_s, needed)


def test_the_refusal_gives_three_cures_that_work():
    with pytest.raises(TimingError, match=r"--rounds 2, --stretch 1\.2, .* 8\.333 ms") as refused:
        check_timing(DEMO, 3, 0.025)
    assert "30 ms" in str(refused.value)
    assert "every 25 ms" in str(refused.value)
    check_timing(DEMO, 2, 0.025)
    check_timing(DEMO, 3, 0.025, 1.2)
    check_timing(AUDI, 3, 0.025)
    for rounds in range(1, 100):
        check_timing(DEMO, rounds, rounds / 100)


def test_the_refusal_offers_no_rounds_where_not_even_one_fits():
    with pytest.raises(TimingError) as refused:
        check_timing(AUDI, 3, 0.0005)
    assert "--rounds" not in str(refused.value)
    assert "--stretch 30" in str(refused.value)


@pytest.mark.parametrize(("rounds", "step", "stretch"), [(0, 1, 1), (1, 0, 1), (1, 1, math.nan)])
def test_nonsense_is_refused(rounds, step, stretch):
    with pytest.raises(TimingError, match="must be positive"):
        check_timing(DEMO, rounds, step, stretch)
