"""Schedules against their defining formulas."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.schedule import (
    Schedule,
    dynamic_only,
    full_publish,
    hybrid,
    publishers_per_cycle,
    round_robin,
)
from tests.bus.support import quick

networks = st.tuples(st.integers(1, 40), st.floats(0.01, 1.0))


@quick
@given(st.integers(1, 50), st.data(), st.integers(0, 10000))
def test_round_robin_is_exact_for_any_number_of_nodes(nodes: int, data, cycle: int):
    slots = data.draw(st.integers(1, nodes))
    schedule = round_robin(nodes, slots)
    expected = tuple((cycle * slots + place) % nodes for place in range(slots))
    assert schedule.static_senders(cycle) == expected
    assert schedule.contenders(cycle) == ()
    assert schedule.dynamic_slots(cycle) == 0
    assert schedule.period == nodes // math.gcd(nodes, slots)


@quick
@given(st.integers(1, 50), st.integers(0, 1000))
def test_full_publish_has_everybody_in_every_cycle(nodes: int, cycle: int):
    assert full_publish(nodes).static_senders(cycle) == tuple(range(nodes))


@quick
@given(networks, st.integers(0, 500))
def test_hybrid_divides_its_slots_as_defined(network: tuple[int, float], cycle: int):
    nodes, occupancy = network
    schedule = hybrid(nodes, occupancy)
    slots = max(1, round(occupancy * nodes))
    static, dynamic = schedule.static_senders(cycle), schedule.dynamic_slots(cycle)
    assert len(static) + dynamic == slots
    contenders = range(math.ceil(nodes / 2), nodes)
    assert set(static) <= set(range(math.ceil(nodes / 2)))
    assert schedule.contenders(cycle) == (tuple(contenders) if dynamic else ())
    if slots - slots // 2 <= len(contenders):
        assert len(static) == slots // 2 + (slots % 2 and cycle % 2 == 0)


@quick
@given(networks)
def test_static_nodes_take_equal_turns_and_never_starve(network: tuple[int, float]):
    schedule = hybrid(*network)
    static_nodes = math.ceil(network[0] / 2)
    turns = [
        node for cycle in range(3 * schedule.period) for node in schedule.static_senders(cycle)
    ]
    assert turns == [turn % static_nodes for turn in range(len(turns))]
    assert len(turns) >= static_nodes


@quick
@given(networks, st.integers(0, 100))
def test_dynamic_only_lets_everybody_contend(network: tuple[int, float], cycle: int):
    nodes, occupancy = network
    schedule = dynamic_only(nodes, occupancy)
    assert schedule.static_senders(cycle) == ()
    assert schedule.contenders(cycle) == tuple(range(nodes))
    assert schedule.dynamic_slots(cycle) == publishers_per_cycle(nodes, occupancy)


def test_the_twenty_node_networks_of_the_study():
    # 20 nodes: occupancy 1, .5, .25, .1 are 20, 10, 5, 2 publishers in a cycle.
    assert [publishers_per_cycle(20, share) for share in (1.0, 0.5, 0.25, 0.1)] == [20, 10, 5, 2]
    quarter = hybrid(20, 0.25)
    assert [quarter.static_senders(cycle) for cycle in range(4)] == [
        (0, 1, 2),
        (3, 4),
        (5, 6, 7),
        (8, 9),
    ]
    assert [quarter.dynamic_slots(cycle) for cycle in range(4)] == [2, 3, 2, 3]


def test_one_slot_alternates_between_the_segments():
    tenth = hybrid(10, 0.1)
    assert [tenth.static_senders(cycle) for cycle in range(4)] == [(0,), (), (1,), ()]
    assert [tenth.contenders(cycle) for cycle in range(2)] == [(), (5, 6, 7, 8, 9)]


@pytest.mark.parametrize("occupancy", [0.0, -0.5, 1.01, math.nan])
def test_impossible_occupancies_are_refused(occupancy: float):
    with pytest.raises(ValueError, match="above 0 and at most 1"):
        hybrid(10, occupancy)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: round_robin(5, 6), "from 1 to 5"),
        (lambda: round_robin(5, 0), "from 1 to 5"),
        (lambda: Schedule(0, ((),)), "at least one"),
        (lambda: Schedule(3, ()), "at least one row"),
        (lambda: Schedule(3, ((0, 3),)), r"0\.\.2"),
        (lambda: Schedule(3, ((0, 0),)), "at most once"),
        (lambda: Schedule(3, ((),), ((1,),), (-1,)), "negative"),
    ],
)
def test_impossible_schedules_are_refused(make, said: str):
    with pytest.raises(ValueError, match=said):
        make()
