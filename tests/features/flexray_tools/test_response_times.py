"""Response times: bounds above every simulated response, and not far above the worst."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.dynamic_segment import MessageSlot, Request, requests_of, walk
from concord.bus.flexray.presets import AUDI, DEMO
from concord.bus.flexray.written_slots import written_bus, written_schedule
from concord.features.flexray_tools.response_times import ResponseTimes
from concord.features.flexray_tools.traffic import worst_responses

SHORT = msgspec.structs.replace(
    DEMO,
    static_slots=2,
    minislots=60,
    latest_transmission_minislot=26,
    macroticks_per_cycle=2 * 272 + 60 * 8 + 6,
    cycle_us=float(2 * 272 + 60 * 8 + 6),
    microticks_per_cycle=40 * (2 * 272 + 60 * 8 + 6),
    network_idle_time_macroticks=6,
)
"""A cluster of 1,030 us whose dynamic segment of 60 minislots a few frames fill."""


def simulated(
    cluster: Cluster, slots: Sequence[MessageSlot], cycles: int, seed: int
) -> list[float]:
    """Worst response of each slot in random traffic, slot by slot as a controller counts.

    Requests come at random, at least a period apart, and often as close as that.
    """
    random = np.random.default_rng(seed)
    order = sorted(range(len(slots)), key=lambda i: slots[i].frame_id)
    period_us = [slot.period_us or slot.repetition * cluster.cycle_us for slot in slots]
    lengths = [cluster.dynamic_slot_minislots(slot.payload_bytes) for slot in slots]
    frame_us = [cluster.frame_us(slot.payload_bytes) for slot in slots]
    following = [random.uniform(0, period) for period in period_us]
    oldest: list[float] = [math.inf] * len(slots)
    worst = [0.0] * len(slots)
    for cycle in range(cycles):
        segment_us = cycle * cluster.cycle_us + cluster.dynamic_segment_start_us
        minislot, count = 1, cluster.static_slots + 1
        for i in order:
            slot = slots[i]
            if cycle % slot.repetition != slot.base_cycle:
                continue
            minislot += slot.frame_id - count
            count = slot.frame_id + 1
            start_us = segment_us + (minislot - 1) * cluster.minislot_us
            while following[i] <= start_us:
                oldest[i] = min(oldest[i], following[i])
                late_us = random.exponential(0.3 * period_us[i]) * (random.random() < 0.3)
                following[i] += period_us[i] + late_us
            own = slot.latest_transmission_minislot
            in_time = minislot <= (cluster.latest_transmission_minislot if own is None else own)
            if oldest[i] <= start_us and in_time and minislot + lengths[i] - 1 <= cluster.minislots:
                end_us = start_us + cluster.minislot_action_point_us + frame_us[i]
                worst[i] = max(worst[i], end_us - oldest[i])
                oldest[i] = math.inf
                minislot += lengths[i]
            else:
                minislot += 1
    return worst


def bounds(cluster: Cluster, slots: Sequence[MessageSlot]) -> list[float]:
    found = {
        (r.slot.frame_id, r.slot.base_cycle): r.worst_us
        for r in ResponseTimes(cluster, slots).responses
    }
    known = [found[slot.frame_id, slot.base_cycle] for slot in slots]
    return [math.inf if bound is None else bound for bound in known]


CROWDED = [
    MessageSlot(frame_id=3, payload_bytes=60, period_us=2000.0),
    MessageSlot(frame_id=4, payload_bytes=100, period_us=4000.0),
    MessageSlot(frame_id=5, payload_bytes=80, period_us=5000.0),
    MessageSlot(frame_id=6, payload_bytes=40, period_us=9000.0),
    MessageSlot(frame_id=8, payload_bytes=20, period_us=12000.0),
]


def test_bounds_of_the_cars_bus_lie_above_random_traffic_and_close_to_it():
    """Frame IDs 52 to 103 with payloads of the recording; no cycle can be filled."""
    payloads = {52: 88, 53: 20, 54: 8, 63: 30, 65: 34, 67: 218, 77: 20, 83: 100, 103: 88}
    turns = {67: (0, 2), 103: (1, 2)}
    slots = [
        MessageSlot(frame_id=i, payload_bytes=size, base_cycle=base, repetition=repetition)
        for i, size in payloads.items()
        for base, repetition in (turns.get(i, (0, 1)),)
    ]
    worst = simulated(AUDI, slots, 20_000, 1)
    for slot, bound, seen in zip(slots, bounds(AUDI, slots), worst, strict=True):
        assert seen <= bound <= 1.1 * seen
        assert slot.repetition * 5000 < bound < slot.repetition * 5000 + 850


def test_a_bound_by_hand():
    """Frame ID 3 has 1 + 9 minislots, ID 4 begins after them or one cycle later at most."""
    slots = [
        MessageSlot(frame_id=3, payload_bytes=60, period_us=2000.0),
        MessageSlot(frame_id=4, payload_bytes=2),
    ]
    first, second = ResponseTimes(SHORT, slots).responses
    # 12 + 10 (8 + 60) bits in minislots of 80 bits: 8.66, so 9, and one more.
    cycle_us, minislot_us = 1030.0, 8.0
    assert first.worst_us == pytest.approx(cycle_us + 3 + 69.2)
    assert second.worst_us == pytest.approx(cycle_us + 9 * minislot_us + 3 + 11.2)
    assert (first.filled_cycles, second.filled_cycles) == (0, 0)


def test_a_static_frame_waits_for_its_next_slot():
    slot = MessageSlot(frame_id=2, payload_bytes=20, repetition=4, base_cycle=3)
    (found,) = ResponseTimes(SHORT, [slot]).responses
    assert found.worst_us == pytest.approx(4 * 1030 + 3 + 263.2)


def test_frames_that_others_may_hold_up_for_ever_have_no_bound():
    """Two long frames in every cycle leave the third no minislot up to pLatestTx."""
    slots = [MessageSlot(frame_id=i, payload_bytes=120) for i in (3, 4, 5)]
    first, second, third = ResponseTimes(SHORT, slots).responses
    assert first.worst_us is not None and second.worst_us is not None
    assert third.worst_us is None
    assert simulated(SHORT, slots, 3000, 1)[2] > 5 * 1030
    beyond = [MessageSlot(frame_id=29, payload_bytes=2)]
    assert ResponseTimes(SHORT, beyond).responses[0].worst_us is None


def test_multiplexed_rivals_hold_up_only_in_their_own_cycles():
    """Rivals of odd cycles leave a frame of even cycles alone."""
    rivals = [
        MessageSlot(frame_id=i, payload_bytes=120, base_cycle=1, repetition=2) for i in (3, 4)
    ]
    even = MessageSlot(frame_id=5, payload_bytes=2, repetition=2)
    odd = msgspec.structs.replace(even, base_cycle=1)
    assert bounds(SHORT, [*rivals, even])[-1] == pytest.approx(2 * 1030 + 3 + 11.2)
    assert bounds(SHORT, [*rivals, odd])[-1] == math.inf


@st.composite
def tables(draw: st.DrawFn) -> list[MessageSlot]:
    slots: list[MessageSlot] = []
    for frame_id in sorted(draw(st.sets(st.integers(3, 16), min_size=1, max_size=7))):
        repetition = draw(st.sampled_from([1, 1, 2, 4]))
        slots.append(
            MessageSlot(
                frame_id=frame_id,
                payload_bytes=2 * draw(st.integers(0, 60)),
                repetition=repetition,
                base_cycle=draw(st.integers(0, repetition - 1)),
                period_us=draw(st.floats(500, 12_000)),
            )
        )
    return slots


@pytest.mark.slow
@settings(max_examples=40)
@given(tables(), st.integers(0, 2**32 - 1))
def test_no_random_traffic_responds_later_than_its_bound(slots: list[MessageSlot], seed: int):
    worst = simulated(SHORT, slots, 600, seed)
    for bound, seen in zip(bounds(SHORT, slots), worst, strict=True):
        assert seen <= bound + 1e-6


@pytest.mark.parametrize("seed", [1, 2])
def test_bounds_of_a_crowded_segment_lie_within_three_tenths_of_random_traffic(seed: int):
    found = ResponseTimes(SHORT, CROWDED).responses
    assert [response.filled_cycles for response in found][-1] > 0
    worst = simulated(SHORT, CROWDED, 100_000, seed)
    for bound, seen in zip(bounds(SHORT, CROWDED), worst, strict=True):
        assert seen <= bound <= 1.3 * seen


TWO_CONTROLLERS = [
    MessageSlot(frame_id=3, payload_bytes=120, node=0),
    MessageSlot(frame_id=4, payload_bytes=120, node=0),
    MessageSlot(frame_id=5, payload_bytes=16, node=1, latest_transmission_minislot=56),
    MessageSlot(frame_id=6, payload_bytes=16, node=1, latest_transmission_minislot=56),
]
"""Two long frames before two short ones, whose controller may begin them later."""


def test_a_later_limit_of_one_controller_lets_its_frames_out_in_every_cycle():
    found = bounds(SHORT, TWO_CONTROLLERS)
    assert max(found[2:]) < 2 * SHORT.cycle_us
    seen = worst_responses(SHORT, TWO_CONTROLLERS, 3000, np.random.default_rng(1))
    for bound, worst_us, other_us in zip(
        found, seen, simulated(SHORT, TWO_CONTROLLERS, 3000, 2), strict=True
    ):
        assert worst_us is not None and max(worst_us, other_us) <= bound < 1.2 * worst_us
    # By the limit of the other controller they wait for ever.
    shared = [without_limit(slot) for slot in TWO_CONTROLLERS]
    assert bounds(SHORT, shared)[2:] == [math.inf, math.inf]
    requests = [Request(slot.node, slot.frame_id, slot.payload_bytes) for slot in shared]
    assert [one.frame_id for one in walk(SHORT, requests).waiting] == [5, 6]
    assert not walk(SHORT, requests_of(TWO_CONTROLLERS, SHORT)).waiting


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 30), st.integers(5, 60)), min_size=3, max_size=6),
    st.integers(0, 2**16),
)
def test_bounds_hold_where_every_controller_has_its_own_limit(drawn, seed: int):
    slots = [
        MessageSlot(
            frame_id=3 + place, payload_bytes=2 * words, node=place,
            latest_transmission_minislot=latest,
        )
        for place, (words, latest) in enumerate(drawn)
    ]  # fmt: skip
    for bound, worst_us in zip(
        bounds(SHORT, slots), simulated(SHORT, slots, 400, seed), strict=True
    ):
        assert worst_us <= bound


def test_a_run_lets_each_node_send_until_its_own_limit():
    stations = [
        msgspec.structs.replace(slot, node=8 + place)
        for place, slot in enumerate(TWO_CONTROLLERS[:2])
    ]
    own = [
        msgspec.structs.replace(slot, node=place, payload_bytes=18)
        for place, slot in enumerate(TWO_CONTROLLERS[2:])
    ]
    for slots, senders in ((own, {0, 1}), ([own[0], without_limit(own[1])], {0})):
        table = (*stations, *slots)
        schedule = written_schedule(table, SHORT, 2)
        bus = written_bus(table, SHORT, schedule, 10, ARBITERS["wtod"])
        frames = bus.transmissions(0, [18, 18])
        assert {frame.node for frame in frames} == senders
        assert bus.dynamic_room() == (2 if len(senders) == 2 else 0)


def without_limit(slot: MessageSlot) -> MessageSlot:
    return msgspec.structs.replace(slot, latest_transmission_minislot=None)
