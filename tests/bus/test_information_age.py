"""Ages of information against shortest paths in a graph of nodes at cycles, and known networks."""

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.information_age import greatest_ages_steps, worst_age_steps
from concord.bus.schedule import Schedule, full_publish, hybrid, round_robin


def heard_by(graph: nx.Graph) -> list[list[int]]:
    return [sorted(graph[node]) for node in range(len(graph))]


def by_paths(schedule: Schedule, graph: nx.Graph, rounds: int, steps: int) -> int:
    """A reading of a step walks a graph of (node, cycle): it waits, or takes a share's link."""
    cycles = steps * rounds
    walks = nx.DiGraph()
    for cycle in range(cycles):
        for node in graph:
            walks.add_edge((node, cycle), (node, cycle + 1))
        for sender in schedule.static_senders(cycle):
            for hearer in graph[sender]:
                walks.add_edge((sender, cycle), (hearer, cycle + 1))
    ages = []
    last = steps - 1
    for place in graph:
        for source in graph:
            steps_known = [
                step
                for step in range(steps)
                if nx.has_path(walks, (source, step * rounds), (place, (last + 1) * rounds))
            ]
            ages.append(last - max(steps_known, default=-1))
    return max(ages)


@given(
    st.integers(2, 6), st.integers(0, 99), st.integers(1, 3), st.integers(1, 6), st.integers(0, 7)
)
@settings(max_examples=15, deadline=None)
def test_ages_are_those_of_walks_through_cycles(nodes, seed, rounds, slots, more):
    graph = nx.random_labeled_tree(nodes, seed=seed)
    schedule = round_robin(nodes, min(slots, nodes))
    steps = nodes * nodes + more
    worst = worst_age_steps(schedule, heard_by(graph), rounds)
    assert worst is not None
    found = [by_paths(schedule, graph, rounds, steps + late) for late in range(3)]
    assert max(found) <= worst
    period = schedule.period
    ages = greatest_ages_steps(
        schedule, heard_by(graph), rounds, steps + period + 3,
        lambda cycle: np.isin(np.arange(nodes), schedule.static_senders(cycle)),
        lambda _: np.ones(nodes, dtype=bool),
    )  # fmt: skip
    assert found == [ages[steps + late - 1] for late in range(3)]
    assert worst == ages[-period:].max()


@pytest.mark.parametrize(("nodes", "rounds"), [(2, 1), (5, 1), (9, 2), (9, 8)])
def test_on_a_path_where_all_send_each_round_is_a_link(nodes, rounds):
    graph = nx.path_graph(nodes)
    worst = worst_age_steps(full_publish(nodes), heard_by(graph), rounds)
    assert worst == -(-(nodes - 1) // rounds) - 1


@pytest.mark.parametrize("nodes", [2, 3, 7])
def test_where_all_hear_all_a_reading_waits_for_its_turn(nodes):
    assert (
        worst_age_steps(round_robin(nodes, 1), heard_by(nx.complete_graph(nodes)), 1) == nodes - 1
    )


def test_a_schedule_with_contention_and_a_graph_in_two_have_no_bound():
    assert worst_age_steps(hybrid(6, 0.5), heard_by(nx.cycle_graph(6)), 1) is None
    assert worst_age_steps(full_publish(4), [[1], [0], [3], [2]], 1) is None


def test_an_unknown_reading_ages_from_when_it_was_taken():
    """Node 0 reads in the steps 3 and 7 alone, node 1 never."""
    graph = heard_by(nx.path_graph(2))
    ages = greatest_ages_steps(
        full_publish(2), graph, 1, 10, lambda cycle: np.array([cycle == 9, True]),
        lambda step: np.array([step in (3, 7), False]),
    )  # fmt: skip
    assert ages.tolist() == [0, 0, 0, 1, 2, 3, 4, 5, 6, 0]


def test_a_pause_between_two_readings_is_no_age():
    """Node 0 reads in the steps 0 and 8 alone, and node 1 hears of both in their steps."""
    ages = greatest_ages_steps(
        full_publish(2), heard_by(nx.path_graph(2)), 1, 10, lambda _: np.ones(2, dtype=bool),
        lambda step: np.array([step in (0, 8), False]),
    )  # fmt: skip
    assert not ages.any()
