"""Longest waits of contenders, and the ages of information that they bound: against any bids, and
against the worst bids that there are."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, NO_BID, ONE_CLASS, UrgencyClasses, begin_arbitration
from concord.bus.flexray.fitted import fitted_cluster
from concord.bus.flexray.flexray_bus import FlexRayBus, flexray_bus
from concord.bus.flexray.presets import AUDI
from concord.bus.flexray.share_frames import payload_lengths
from concord.bus.ideal import TimelessBus
from concord.bus.information_age import greatest_ages_steps, worst_contended_age_steps
from concord.bus.longest_wait import LongestWait
from concord.bus.schedule import Schedule, dynamic_only, hybrid
from tests.bus.support import quick

LEAST, MOST = 16, 16 * 2**10
COUNT = 4


def bus_of(schedule: Schedule, arbiter: str = "urgency", turns: int = 1) -> FlexRayBus:
    """A bus that holds whatever wins; contenders are old after so many turns of all."""
    contenders = {node for row in schedule.contender_table for node in row}
    classes = UrgencyClasses(COUNT, LEAST, MOST, old_after=turns * len(contenders))
    if arbiter != "urgency":
        classes = ONE_CLASS
    cluster = fitted_cluster(schedule, payload_lengths(60), classes.count)
    return flexray_bus(schedule, cluster, 60, ARBITERS[arbiter], classes=classes)


def wait_of(bus: FlexRayBus) -> LongestWait:
    assert bus.longest_wait is not None
    return bus.longest_wait


def winners(bus: FlexRayBus, rows: list[list[int]]) -> list[set[int]]:
    """The winners of each cycle in which nodes bid so."""
    found, state = [], begin_arbitration(bus.schedule.nodes)
    for cycle, bids in enumerate(rows):
        won: set[int] = set()
        for group, (_, slots) in enumerate(bus.schedule.groups(cycle)):
            left = [one for one in bus.schedule.contenders(cycle) if one not in won]
            if slots and left:
                asked = np.array([bids[node] for node in left])
                state, wins, *_ = bus.arbitrate(state, cycle, group, left, asked, unasked)
                won |= set(np.array(left)[wins].tolist())
        found.append(won)
    return found


def unasked() -> np.ndarray:
    raise AssertionError("all shares fit")


@quick
@given(
    st.sampled_from(["urgency", "round-robin"]),
    st.sampled_from(["dynamic", "hybrid", "relay"]),
    st.integers(3, 9),
    st.integers(1, 4),
    st.integers(1, 3),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_no_bids_make_a_contender_wait_for_longer(
    arbiter, shape, nodes, slots, turns, all_ask, random
):
    part = min(slots, nodes) / nodes
    schedule = hybrid(nodes, part) if shape == "hybrid" else dynamic_only(nodes, part)
    if shape == "relay":
        tables = schedule.static_table, schedule.contender_table, schedule.dynamic_slot_table
        schedule = Schedule(nodes, *tables, relay=True)
    bus = bus_of(schedule, arbiter, turns)
    contenders = sorted({node for row in schedule.contender_table for node in row})
    watched, levels = random.choice(contenders), [NO_BID, LEAST, MOST]
    rows: list[list[int]] = []
    for cycle in range(6 * turns * nodes):
        keep = rows and random.random() < 0.8
        bids = rows[-1] if keep else [random.choice(levels[all_ask:]) for _ in range(nodes)]
        bids[watched] = LEAST if all_ask or cycle % 7 else bids[watched]
        rows.append(list(bids))
    wait, asked = wait_of(bus), 0
    for cycle, won in enumerate(winners(bus, rows)):
        asked = asked + 1 if rows[cycle][watched] != NO_BID else 0
        assert asked <= wait.first_cycles
        if all_ask and cycle >= wait.first_cycles:
            assert asked <= wait.next_cycles
        if watched in won:
            asked = 0


@pytest.mark.parametrize(("nodes", "slots", "turns"), [(6, 1, 1), (9, 2, 1), (12, 3, 12)])
def test_the_worst_bids_make_a_contender_wait_for_as_long(nodes, slots, turns):
    bus = bus_of(dynamic_only(nodes, slots / nodes), turns=turns)
    wait = wait_of(bus)
    assert wait == (turns * nodes + (nodes - 1) // slots, turns * nodes + 1)
    rows = [[MOST] * slots + [LEAST] * (nodes - slots)] * wait.first_cycles
    won = winners(bus, rows)
    assert not any(nodes - 1 in one for one in won[:-1])
    assert nodes - 1 in won[-1]


@pytest.mark.parametrize("nodes", [8, 12])
def test_bids_against_the_way_of_a_reading_make_it_nearly_as_old_as_the_bound(nodes):
    """Readings walk down a path, and the next node has always sent just before."""
    bus, graph = bus_of(dynamic_only(nodes, 1 / nodes)), nx.path_graph(nodes)
    heard = [sorted(graph[node]) for node in range(nodes)]
    wait = wait_of(bus)
    rows = [[MOST] + [LEAST] * (nodes - 1)] * (nodes * wait.first_cycles)
    won = winners(bus, rows)

    def sent(cycle: int) -> np.ndarray:
        return np.isin(np.arange(nodes), list(won[cycle]))

    ages = greatest_ages_steps(
        bus.schedule, heard, 1, len(rows), sent, lambda _: np.ones(nodes, dtype=bool)
    )
    bound = worst_contended_age_steps(bus.schedule, heard, 1, wait)
    assert bound is not None
    assert ages.max() <= bound <= 1.1 * ages.max()


@quick
@given(
    st.integers(2, 7),
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(0, 99),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_no_bids_make_information_older(nodes, slots, rounds, seed, halves, random):
    part = min(slots, nodes) / nodes
    schedule = hybrid(nodes, part) if halves else dynamic_only(nodes, part)
    graph = nx.random_labeled_tree(nodes, seed=seed)
    heard = [sorted(graph[node]) for node in range(nodes)]
    bus = bus_of(schedule)
    steps = 6 * nodes
    rows = [
        [random.choice([LEAST, MOST]) for _ in range(nodes)]
        for _ in range(steps * rounds // 8 + 1)
        for _ in range(8)
    ]
    won = winners(bus, rows)

    def sent(cycle: int) -> np.ndarray:
        return np.isin(np.arange(nodes), [*schedule.static_senders(cycle), *won[cycle]])

    ages = greatest_ages_steps(
        schedule, heard, rounds, steps, sent, lambda _: np.ones(nodes, dtype=bool)
    )
    bound = worst_contended_age_steps(schedule, heard, rounds, wait_of(bus))
    assert bound is not None
    assert ages.max() <= bound


def test_arbiters_without_memory_bound_no_wait_unless_all_shares_fit():
    assert bus_of(dynamic_only(6, 0.5), "wtod").longest_wait is None
    for arbiter in ("wtod", "minislot"):
        assert bus_of(dynamic_only(6, 1.0), arbiter).longest_wait == (1, 1)
    assert bus_of(dynamic_only(6, 0.5), "minislot").longest_wait is None
    # FlexRay sends whatever fits: the occupancy is no limit.
    roomy = flexray_bus(dynamic_only(6, 0.5), AUDI, 60, ARBITERS["minislot"])
    assert roomy.longest_wait == (1, 1)
    crowded = flexray_bus(dynamic_only(30, 1.0), AUDI, 200, ARBITERS["minislot"])
    assert crowded.longest_wait is None
    assert TimelessBus(dynamic_only(6, 0.5), 60, ARBITERS["round-robin"]).longest_wait == (2, 2)


def test_a_node_that_never_hears_of_another_has_no_bound():
    schedule = dynamic_only(4, 0.25)
    assert worst_contended_age_steps(schedule, [[1], [0], [3], [2]], 1, LongestWait(5, 5)) is None
