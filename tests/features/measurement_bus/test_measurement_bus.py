"""The measurement bus against the paper's rule written out sensor by sensor, and its matrices."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from concord.bus.schedule import Schedule
from concord.features.measurement_bus.measurement_bus import (
    BID_RESOLUTION,
    MeasurementBus,
    all_at_once,
    bid,
    flexray,
    largest_change,
    nobody,
    round_robin,
    try_once_discard,
    zero_input,
)
from tests.features.measurement_bus.measurement_matrices import (
    receive,
    receive_by_segments,
    segment,
    slot_matrices,
    static_turn,
)

FLEXRAY_SENSORS = st.integers(2, 7).flatmap(
    lambda sensors: st.tuples(
        st.lists(st.integers(1, 3), min_size=sensors, max_size=sensors),
        st.integers(1, sensors - 1),
    )
)


def numbers(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def by_hand(sizes, static_slots, slot, measurement, received, weights):
    """Equations (2) to (5), sensor by sensor: the sender of slot s (1..N), and ybar_s."""
    ends = np.cumsum([0, *sizes])
    rows = [range(*pair) for pair in pairwise(ends)]
    place = (slot - 1) % (static_slots + 1)
    if place < static_slots:
        sender = place + 1
    else:
        changes = {}
        for j in range(static_slots + 1, len(sizes) + 1):
            change = [measurement[i] - received[i] for i in rows[j - 1]]
            changes[j] = float(np.array(change) @ weights[j - 1] @ np.array(change))
        sender = max(changes, key=lambda j: (changes[j], -j))
    after = list(received)
    for i in rows[sender - 1]:
        after[i] = measurement[i]
    return sender, np.array(after)


def random_weights(seed: int, sizes) -> tuple[np.ndarray, ...]:
    roots = [numbers(seed + j, size, size) for j, size in enumerate(sizes)]
    return tuple(root @ root.T + 0.1 * np.eye(len(root)) for root in roots)


def sender_of(schedule: Schedule, slot: int) -> int | str:
    senders = schedule.static_senders(slot)
    return senders[0] if senders else "d"


# --- who sends -----------------------------------------------------------------------------------


def test_the_first_cycles_of_the_paper():
    schedule = flexray(6, 4)
    assert [sender_of(schedule, slot) for slot in range(1, 11)] == [1, 2, 3, 4, "d"] * 2
    assert [schedule.contenders(slot) for slot in (4, 5, 6, 10)] == [(), (5, 6), (), (5, 6)]


@given(st.integers(2, 9).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n - 1))))
def test_equation_2_with_q_the_cycle(network: tuple[int, int]):
    sensors, static_slots = network
    schedule = flexray(sensors, static_slots)
    for slot in range(1, 4 * (static_slots + 1) + 1):
        turn = static_turn(slot, static_slots)
        assert schedule.static_senders(slot) == ((turn,) if turn else ())
        assert segment(slot, static_slots) == (turn == 0) == bool(schedule.contenders(slot))


def test_the_common_misreading_is_another_order():
    misread = [(slot - 1) % 4 + 1 for slot in range(1, 11)]
    turns = [static_turn(slot, 4) for slot in range(1, 11)]
    assert turns[:4] == misread[:4]
    assert turns[5] == 1 != misread[5]


def test_the_first_turn_may_be_in_slot_0():
    turns = [sender_of(flexray(4, 2, first=0), slot) for slot in range(6)]
    assert turns == [1, 2, "d", 1, 2, "d"]
    assert flexray(4, 2, first=0).contenders(2) == (3, 4)
    assert [sender_of(round_robin(3, [2, 3], first=0), slot) for slot in range(3)] == [2, 3, 2]


def test_without_contenders_each_cycle_ends_with_an_empty_slot():
    schedule = flexray(3, 3, first=0)
    senders = [schedule.static_senders(slot) for slot in range(5)]
    assert senders == [(1,), (2,), (3,), (), (1,)]
    assert schedule.contenders(3) == ()


def test_round_robin_begins_with_its_first_member():
    schedule = round_robin(6, [2, 5, 3])
    assert [sender_of(schedule, slot) for slot in range(1, 8)] == [2, 5, 3, 2, 5, 3, 2]


def test_the_comparisons():
    assert all_at_once(3).static_senders(7) == (1, 2, 3)
    assert nobody(3).static_senders(7) == nobody(3).contenders(7) == ()
    assert try_once_discard(6, [5, 6]).contenders(3) == (5, 6)


# --- what is received ----------------------------------------------------------------------------


@given(FLEXRAY_SENSORS, st.integers(1, 40), st.integers(0, 2**20))
def test_rule_hand_matrices_and_segments_agree(sensors, slot: int, seed: int):
    sizes, static_slots = sensors
    m, weights = sum(sizes), random_weights(seed, sizes)
    measurement, received = numbers(seed, 2, m)
    bus = MeasurementBus(tuple(sizes), flexray(len(sizes), static_slots), weights)
    result = bus.transmit(slot, measurement, received)
    sender, after = by_hand(sizes, static_slots, slot, measurement, received, weights)
    assert np.flatnonzero(result.sent).tolist() == [sender - 1]
    np.testing.assert_array_equal(result.received, after)
    matrices = slot_matrices(sizes, static_slots, slot, sender)
    np.testing.assert_array_equal(receive(matrices, measurement, received), after)
    segments = receive_by_segments(sizes, static_slots, slot, sender, measurement, received)
    np.testing.assert_array_equal(segments, after)


@given(FLEXRAY_SENSORS, st.integers(1, 40))
def test_every_entry_is_either_fresh_or_held(sensors, slot: int):
    sizes, static_slots = sensors
    matrices = slot_matrices(sizes, static_slots, slot, len(sizes))
    np.testing.assert_array_equal(matrices.fresh + matrices.held, np.eye(sum(sizes)))
    np.testing.assert_array_equal(matrices.fresh @ matrices.held, np.zeros_like(matrices.held))
    sender = static_turn(slot, static_slots) or len(sizes)
    assert np.trace(matrices.fresh) == sizes[sender - 1]


def test_equal_changes_go_to_the_lowest_sensor():
    bus = MeasurementBus((1, 1, 1), try_once_discard(3, [1, 2, 3]))
    sent = bus.transmit(1, np.array([1.0, -2.0, 2.0]), np.zeros(3)).sent
    assert sent.tolist() == [False, True, False]


def test_weights_decide_who_wins():
    measurement = np.array([1.0, 2.0, 2.0])
    sizes, schedule = (1, 2), try_once_discard(2, [1, 2])
    for weights, winner in (((np.eye(1), np.eye(2)), 2), ((9 * np.eye(1), np.eye(2)), 1)):
        bus = MeasurementBus(sizes, schedule, weights)
        assert np.flatnonzero(bus.transmit(1, measurement, np.zeros(3)).sent) == [winner - 1]


def test_weights_may_differ_from_slot_to_slot():
    turns = ((np.eye(1), 9 * np.eye(1)), (9 * np.eye(1), np.eye(1)))
    bus = MeasurementBus((1, 1), try_once_discard(2, [1, 2]), lambda slot: turns[slot % 2])
    for slot, winner in ((4, 2), (5, 1)):
        assert np.flatnonzero(bus.transmit(slot, np.ones(2), np.zeros(2)).sent) == [winner - 1]
    with pytest.raises(ValueError, match="1 weights for 2 sensors"):
        MeasurementBus((1, 1), try_once_discard(2, [1, 2]), lambda slot: (np.eye(1),))


def test_what_is_contended_for_is_the_change_and_not_the_value():
    bus = MeasurementBus((1, 1), try_once_discard(2, [1, 2]))
    result = bus.transmit(1, np.array([9.0, 1.0]), np.array([9.1, 0.0]))
    assert result.sent.tolist() == [False, True]
    np.testing.assert_array_equal(result.received, [9.1, 1.0])


def test_zero_input_forgets():
    bus = MeasurementBus((1, 1), round_robin(2, [1, 2]), silent=zero_input)
    first = bus.transmit(1, np.array([3.0, 4.0]), np.array([1.0, 2.0]))
    np.testing.assert_array_equal(first.received, [3.0, 0.0])


def test_a_sensor_without_a_measurement_neither_sends_nor_wins():
    bus = MeasurementBus((1, 2), try_once_discard(2, [1, 2]))
    result = bus.transmit(1, np.array([0.0, np.nan, 8.0]), np.array([0.5, 0.5, 0.5]))
    assert result.sent.tolist() == [True, False]
    np.testing.assert_array_equal(result.received, [0.0, 0.5, 0.5])
    silent = MeasurementBus((1, 2), all_at_once(2)).transmit(1, np.full(3, np.nan), np.ones(3))
    assert not silent.sent.any()
    np.testing.assert_array_equal(silent.received, np.ones(3))


def test_two_dynamic_slots_go_to_the_two_largest():
    schedule = Schedule(4, ((),), ((1, 2, 3),), (2,))
    bus = MeasurementBus((1, 1, 1), schedule)
    assert bus.transmit(1, np.array([3.0, 1.0, 2.0]), np.zeros(3)).sent.tolist() == [1, 0, 1]


@given(st.integers(0, 2**20), st.integers(1, 12))
def test_runs_in_a_batch_do_not_touch_each_other(seed: int, slot: int):
    bus = MeasurementBus((2, 1, 3, 1), flexray(4, 1), random_weights(seed, (2, 1, 3, 1)))
    measurement, received = numbers(seed, 2, 5, 3, 7)
    together = bus.transmit(slot, measurement, received)
    for lane in np.ndindex(5, 3):
        alone = bus.transmit(slot, measurement[lane], received[lane])
        np.testing.assert_array_equal(together.received[lane], alone.received)
        np.testing.assert_array_equal(together.fresh[lane], alone.fresh)


# --- bids ----------------------------------------------------------------------------------------


CHANGES = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3)
SCALES = st.floats(-6, 6).map(lambda exponent: 10.0**exponent)


@given(st.tuples(CHANGES, CHANGES), st.integers(0, 2**20), SCALES)
def test_bids_have_the_order_of_the_weighted_squares_to_their_resolution(changes, seed, scale):
    (weight,) = random_weights(seed, (3,))
    exact = [float(scale**2 * np.array(one) @ weight @ np.array(one)) for one in changes]
    made = bid(scale * np.array(changes), weight)
    assert made.dtype == np.int64 and (made >= 0).all()
    assume(all(one == 0.0 or one > 1e-200 for one in exact))
    if made[0] > made[1]:
        assert exact[0] >= exact[1] * (1 - 1e-12)
    elif made[0] == made[1]:
        assert abs(exact[0] - exact[1]) <= max(exact) * (BID_RESOLUTION + 1e-12)


@given(FLEXRAY_SENSORS, st.integers(0, 2**20), SCALES)
def test_winners_do_not_change_under_a_common_factor(sensors, seed: int, scale: float):
    """Equation (4) has no unit: neither may its winners."""
    sizes, _ = sensors
    schedule = try_once_discard(len(sizes), range(1, len(sizes) + 1))
    bus = MeasurementBus(tuple(sizes), schedule, random_weights(seed, sizes))
    measurement, received = numbers(seed, 2, 20, sum(sizes))
    expected = bus.transmit(1, measurement, received).sent
    scaled = bus.transmit(1, scale * measurement, scale * received).sent
    np.testing.assert_array_equal(scaled, expected)


@given(FLEXRAY_SENSORS, st.integers(0, 2**20), st.integers(-400, 400))
def test_bids_move_by_one_number_under_a_power_of_two(sensors, seed: int, exponent: int):
    sizes, _ = sensors
    bus = MeasurementBus(tuple(sizes), all_at_once(len(sizes)), random_weights(seed, sizes))
    measurement, received = numbers(seed, 2, sum(sizes))
    factor = 2.0**exponent
    before = bus.bids(1, measurement, received)
    moved = bus.bids(1, factor * measurement, factor * received) - before
    np.testing.assert_array_equal(moved, round(2 * exponent / BID_RESOLUTION))


@given(CHANGES, st.integers(0, 2**20), SCALES)
def test_no_change_with_a_bid_or_a_lower_one_is_above_its_limit(change, seed: int, scale: float):
    (weight,) = random_weights(seed, (3,))
    change = scale * np.array(change)
    exact = _weighted_square(change, weight)
    assume(exact == 0 or exact > 1e-200)
    limit = float(largest_change(bid(change, weight)))
    assert exact <= limit
    assert limit <= float(exact) * (1 + 2 * BID_RESOLUTION) + 1e-300


def _weighted_square(change, weight: np.ndarray) -> Fraction:
    parts = [Fraction(float(one)) for one in change]
    rows = [[Fraction(float(entry)) for entry in row] for row in weight]
    return sum(
        (a * entry * b for a, row in zip(parts, rows, strict=True)
         for entry, b in zip(row, parts, strict=True)), Fraction(0),
    )  # fmt: skip


def test_no_bid_for_no_measurement():
    changes = np.array([[np.nan, 1.0], [0.0, 0.0], [-0.0, 0.0]])
    assert bid(changes, np.eye(2)).tolist() == [-1, 0, 0]


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("static_slots", [-1, 7])
def test_more_static_slots_than_sensors(static_slots: int):
    with pytest.raises(ValueError, match=f"{static_slots} static slots for 6 sensors; take 0 to 6"):
        flexray(6, static_slots)


def test_a_bus_that_does_not_fit_its_sensors():
    with pytest.raises(ValueError, match="schedule for 4 nodes on a measurement bus with 2"):
        MeasurementBus((1, 1), round_robin(3, [1]))
    with pytest.raises(ValueError, match="node 0 of a measurement bus receives"):
        MeasurementBus((1, 1), Schedule(3, ((0,),)))
    with pytest.raises(ValueError, match=r"weight of sensor 2 has shape \(1, 1\)"):
        MeasurementBus((1, 2), round_robin(2, [1]), (np.eye(1), np.eye(1)))
    with pytest.raises(ValueError, match="1 weights for 2 sensors"):
        MeasurementBus((1, 1), round_robin(2, [1]), (np.eye(1),))
    with pytest.raises(ValueError, match="give one size per sensor"):
        MeasurementBus((1, 0), round_robin(2, [1]))
