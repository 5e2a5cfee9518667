"""Slot tables: the schedule they came from, over all 64 cycles, one owner for each slot."""

from collections import Counter

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.dynamic_segment import Request
from concord.bus.flexray.presets import AUDI, DEMO, FLEXRAY_ADAPTER
from concord.bus.flexray.slot_table import (
    SlotAssignment,
    SlotTable,
    allocate,
    deviations,
)
from concord.bus.schedule import Schedule, dynamic_only, full_publish, hybrid, round_robin
from tests.bus.support import quick

BIG = msgspec.structs.replace(
    DEMO,
    name="big",
    static_slots=40,
    static_slot_macroticks=27,
    static_payload_words=5,
    network_idle_time_macroticks=10000 - 40 * 27 - 4400,
)


@st.composite
def schedules(draw: st.DrawFn) -> Schedule:
    nodes = draw(st.integers(1, 20))
    occupancy = draw(st.floats(0.05, 1.0))
    return draw(
        st.sampled_from(
            [
                round_robin(nodes, draw(st.integers(1, nodes))),
                hybrid(nodes, occupancy),
                dynamic_only(nodes, occupancy),
            ]
        )
    )


def senders(table: SlotTable, cycle: int) -> list[int]:
    return [slot.node for slot in table.static_slots(cycle)]


@quick
@given(schedules(), st.integers(1, 2))
def test_slots_and_schedule_agree_in_every_cycle(schedule: Schedule, frames: int):
    table = allocate(schedule, BIG, (10,) * frames, (254,) * frames)
    for cycle in range(2 * schedule.period + 64):
        twice = [node for node in schedule.static_senders(cycle) for _ in range(frames)]
        assert senders(table, cycle) == twice
        ids = [slot.frame_id for slot in table.static_slots(cycle)]
        assert ids == list(range(1, len(ids) + 1))
        owners = Counter(slot.frame_id for slot in table.assignments if slot.sends(cycle))
        assert max(owners.values()) == 1


@quick
@given(schedules(), st.integers(1, 2))
def test_rows_of_a_period_are_the_slots_of_its_cycles(schedule: Schedule, frames: int):
    table = allocate(schedule, BIG, (10,) * frames, (254,) * frames)
    period = len(schedule.static_table)
    rows = table.static_rows(period)
    assert [tuple(row) for row in rows] == [table.static_slots(cycle) for cycle in range(period)]
    nodes = {node for row in schedule.contender_table for node in row}
    assert table.requests() == {node: table.request(node) for node in nodes}


@quick
@given(schedules())
def test_multiplexing_is_exact_when_the_counter_wraps(schedule: Schedule):
    """A controller knows the cycle only modulo 64: where nothing deviates, that is enough."""
    table = allocate(schedule, BIG, (10,), (254,))
    static = [slot for slot in table.assignments if slot.frame_id <= BIG.static_slots]
    if deviations(static, BIG):
        assert 64 % len(schedule.static_table)
        return
    for cycle in range(64, 256):
        assert senders(table, cycle % 64) == list(schedule.static_senders(cycle))


def test_a_share_of_a_power_of_two_needs_one_entry_for_each_slot_and_node():
    table = allocate(round_robin(16, 4), DEMO, (254,), ())
    assert len(table.assignments) == 16
    assert {slot.repetition for slot in table.assignments} == {4}
    assert table.assignments[0] == SlotAssignment(1, 0, "A", 0, 4)
    assert deviations(table.assignments, DEMO) == ()


def test_a_table_longer_than_its_period_is_multiplexed_as_the_short_one():
    table = allocate(Schedule(2, ((0,), (1,)) * 8), DEMO, (254,), ())
    assert table.assignments == (SlotAssignment(1, 0, "A", 0, 2), SlotAssignment(1, 1, "A", 1, 2))


def test_other_periods_are_told():
    table = allocate(round_robin(12, 1), DEMO, (254,), ())
    (sentence,) = deviations(table.assignments, DEMO)
    assert "slot 1" in sentence
    assert "12 cycles" in sentence
    sixty = msgspec.structs.replace(DEMO, number_of_cycles=60)
    assert len(deviations(allocate(round_robin(16, 4), sixty, (254,), ()).assignments, sixty)) == 0
    assert len(deviations(allocate(round_robin(8, 1), sixty, (254,), ()).assignments, sixty)) == 1


def test_contenders_get_the_dynamic_ids_that_follow_the_static_segment():
    table = allocate(hybrid(4, 0.5), AUDI, (34,) * 3, (100,))
    assert [slot.node for slot in table.static_slots(0)] == [0, 0, 0]
    assert table.request(2) == Request(2, 52, 100)
    assert table.request(3).frame_id == 53
    with pytest.raises(ValueError, match="node 0 owns no dynamic slot"):
        table.request(0)


def test_long_shares_take_consecutive_dynamic_slots():
    table = allocate(dynamic_only(3, 0.5), FLEXRAY_ADAPTER, (), (16, 16, 8))
    assert [table.request(node).frame_id for node in range(3)] == [61, 64, 67]
    assert table.request(0).payload_bytes == 40


def test_more_static_slots_than_the_cluster_holds_are_refused():
    with pytest.raises(ValueError, match=r"needs 120 static slots.*'audi' has 51"):
        allocate(full_publish(20), AUDI, (34,) * 6, ())
    allocate(full_publish(8), AUDI, (34,) * 6, ())


@pytest.mark.parametrize(
    ("static", "dynamic", "said"),
    [
        ((36,), (34,), "static frames of"),
        ((), (34,), "static frames of"),
        ((34,), (300,), "dynamic frames of"),
        ((34,), (), "dynamic frames of"),
        ((34,), (100, 100), "dynamic frames of"),
    ],
)
def test_payloads_that_the_frames_do_not_carry_are_refused(static, dynamic, said: str):
    with pytest.raises(ValueError, match=said):
        allocate(hybrid(4, 0.5), AUDI, static, dynamic)


def test_contenders_that_could_never_send_are_refused():
    with pytest.raises(ValueError, match="node 157 could never send in dynamic slot 218"):
        allocate(dynamic_only(158, 0.1), FLEXRAY_ADAPTER, (), (16,))
    allocate(dynamic_only(157, 0.1), FLEXRAY_ADAPTER, (), (16,))


@quick
@given(schedules())
def test_a_multiplexed_table_gives_back_its_schedule(schedule: Schedule):
    table = allocate(schedule, BIG, (10,), (254,))
    if deviations(table.assignments, BIG):
        return
    for cycle in range(64):
        static = [slot.node for slot in table.static_slots(cycle)]
        assert tuple(static) == schedule.static_senders(cycle)
        if schedule.dynamic_slots(cycle):
            dynamic = {s.node for s in table.assignments if s.frame_id >= table.first_dynamic_id}
            assert dynamic >= set(schedule.contenders(cycle))
