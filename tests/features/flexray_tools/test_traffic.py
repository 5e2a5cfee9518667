"""Random traffic: never later than the bounds, alike for alike seeds, and channels on their own."""

from math import inf

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.dynamic_segment import MessageSlot
from concord.features.flexray_tools.traffic import worst_responses
from tests.features.flexray_tools.test_response_times import (
    CROWDED,
    SHORT,
    bounds,
    simulated,
    tables,
)

BOTH = msgspec.structs.replace(SHORT, channels="AB")


def worst(slots: list[MessageSlot], cycles: int, seed: int, cluster=SHORT):
    return worst_responses(cluster, slots, cycles, np.random.default_rng(seed))


@settings(max_examples=25)
@given(tables(), st.integers(0, 2**32 - 1), st.data())
def test_no_response_is_later_than_its_bound_on_two_channels(slots, seed: int, data):
    channels = [data.draw(st.sampled_from(["A", "B", "AB"])) for _ in slots]
    mixed = [
        msgspec.structs.replace(slot, channel=one)
        for slot, one in zip(slots, channels, strict=True)
    ]
    for bound, seen in zip(bounds(BOTH, mixed), worst(mixed, 800, seed, BOTH), strict=True):
        assert seen is None or seen <= bound + 1e-6


def test_traffic_is_as_bad_as_that_of_an_independent_count():
    other = simulated(SHORT, CROWDED, 50_000, 1)
    for seen, beside in zip(worst(CROWDED, 50_000, 1), other, strict=True):
        assert seen == pytest.approx(beside, rel=0.08)


def test_channels_count_their_slots_apart():
    long = MessageSlot(frame_id=3, payload_bytes=120)
    short = MessageSlot(frame_id=4, payload_bytes=2)
    alone = worst([short], 3000, 2, BOTH)[0]
    apart = worst([msgspec.structs.replace(long, channel="B"), short], 3000, 2, BOTH)[1]
    behind = worst([long, short], 3000, 2, BOTH)[1]
    assert alone is not None and apart is not None and behind is not None
    minislots = BOTH.dynamic_slot_minislots(120) - 1
    # Requests differ between the first two, so their worst differ by their luck: a few us.
    assert apart == pytest.approx(alone, abs=15)
    assert behind > alone + 0.9 * minislots * BOTH.minislot_us - 15


def test_equal_seeds_give_equal_traffic_and_no_cycles_give_none():
    assert worst(CROWDED, 500, 3) == worst(CROWDED, 500, 3) != worst(CROWDED, 500, 4)
    assert worst(CROWDED, 0, 3) == (None,) * len(CROWDED)


def test_a_static_frame_waits_for_a_whole_turn_at_most_and_nearly():
    slot = MessageSlot(frame_id=2, payload_bytes=20, repetition=4, base_cycle=3)
    (seen,) = worst([slot], 20_000, 1)
    assert seen is not None
    bound = 4 * 1030 + 3 + 263.2
    assert 0.98 * bound < seen <= bound


def test_requests_with_an_offset_come_at_their_times():
    """A request 20 us after slot 1 begins waits for the next cycle, each time."""
    slot = MessageSlot(frame_id=1, payload_bytes=20, period_us=2060.0, offset_us=20.0)
    (seen,) = worst([slot], 100, 1)
    assert seen == pytest.approx(1030 - 20 + 3 + 263.2)


@st.composite
def urgent_tables(draw: st.DrawFn) -> list[MessageSlot]:
    """Nodes with one ID in each of some classes, and stations with one ID between them."""
    nodes, classes = draw(st.integers(1, 4)), draw(st.integers(2, 3))
    size = st.integers(0, 50).map(lambda words: 2 * words)
    lengths = [draw(size) for _ in range(nodes)]
    rows = [(node, level) for level in range(classes) for node in range(nodes)]
    ids = sorted(draw(st.sets(st.integers(3, 24), min_size=len(rows), max_size=len(rows))))
    slots = [
        MessageSlot(frame_id=frame_id, node=node, urgency_class=level, payload_bytes=lengths[node])
        for frame_id, (node, level) in zip(ids, rows, strict=True)
    ]
    for frame_id in draw(st.sets(st.integers(3, 24), max_size=2)) - {*ids}:
        period_us = draw(st.floats(1500, 9000))
        slots.append(
            MessageSlot(
                frame_id=frame_id, node=50 + frame_id, payload_bytes=draw(size), period_us=period_us
            )
        )
    return sorted(slots, key=lambda slot: slot.frame_id)


@settings(max_examples=60)
@given(urgent_tables(), st.integers(0, 2**32 - 1))
def test_a_node_sends_one_class_a_cycle_and_within_its_bound(slots, seed: int):
    for bound, seen in zip(bounds(SHORT, slots), worst(slots, 800, seed), strict=True):
        assert seen is None or seen <= bound + 1e-6


def test_classes_of_one_node_are_rivals_once():
    """Three nodes with four classes: each frame waits for two others at most, not for eleven."""
    slots = [
        MessageSlot(frame_id=3 + 3 * level + node, node=node, urgency_class=level, payload_bytes=20)
        for level in range(4)
        for node in range(3)
    ]
    alone = [msgspec.structs.replace(slot, node=place) for place, slot in enumerate(slots)]
    assert max(bounds(SHORT, alone)) == inf
    found, seen = bounds(SHORT, slots), worst(slots, 30_000, 3)
    length_us = SHORT.dynamic_slot_minislots(20) * SHORT.minislot_us
    empty_us = 9 * SHORT.minislot_us
    frame_us = SHORT.minislot_action_point_us + SHORT.frame_us(20)
    # The last ID: two nodes before it, nine empty slots, and its own first class was just missed.
    expected = SHORT.cycle_us + 2 * length_us + empty_us + frame_us - 2 * SHORT.minislot_us
    assert found[-1] == pytest.approx(expected)
    for bound, one in zip(found, seen, strict=True):
        assert one is not None and one <= bound < 1.3 * one
