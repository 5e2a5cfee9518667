"""How records spread, against what the nodes themselves hold at the end."""

from itertools import product

import numpy as np
import pytest

from concord.bus.information_age import worst_contended_age_steps
from concord.bus.longest_wait import LongestWait
from concord.bus.schedule import dynamic_only
from concord.results.figures.summary_table import details
from concord.results.records.record_spread import NEVER, RecordSpread, figures_of
from concord.results.records.record_spread import lines as words_of
from concord.results.records.trace import read_trace
from concord.runtime import in_process
from concord.runtime.drivers import drive
from concord.runtime.recording import MemoryRecorder
from concord.scenarios.build import build_environment, build_node
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.design.information_age import record_lag_steps
from tests.experiments.support import summary_of


def setup_of(**options) -> Setup:
    chosen = {"scenario": "oscillator", "nodes": 6, "steps": 20, **options}
    return prepare(scenario_of(**chosen))


@pytest.mark.parametrize("lossy", [{}, {"loss": 0.4}, {"loss": 0.2, "cluster": "audi"}])
def test_arrivals_are_what_the_nodes_hold(lossy: dict):
    setup = setup_of(rule="labelled", occupancy=0.4, window_steps=6, **lossy)
    recorder = MemoryRecorder()
    nodes = [build_node(setup, node) for node in range(6)]
    states = in_process.run(build_environment(setup), nodes, recorder)
    spread = read_trace(setup, recorder.messages).spread
    assert spread is not None
    last = setup.scenario.steps - 1
    for node, state in enumerate(states):
        windows = state.content.windows
        for place, records in enumerate(state.content.kept.records):
            came = spread.arrival_steps[node, windows.step_at(place)]
            assert set(np.flatnonzero((came != NEVER) & (came <= last)).tolist()) == set(records)


def test_figures_of_a_spread_that_is_known():
    """Two nodes, four steps; the second hears of step 0 at once, of 1 a step late, of 2 never."""
    taken = np.array([[True, False], [True, False], [True, False], [False, False]])
    arrival = np.full((2, 4, 2), NEVER)
    arrival[0, [0, 1, 2], 0] = [0, 1, 2]
    arrival[1, [0, 1], 0] = [0, 2]
    spread = RecordSpread(taken, arrival, 2, np.array([10, 20, 30, 40]), 8, 2, 4)
    figures = figures_of(spread)
    assert figures.coverage == 2 / 3
    assert (figures.delay_steps_mean, figures.delay_steps_max) == (0.5, 1)
    # At node 1 the newest is that of step 0 until step 2, then that of step 1.
    assert figures.age_steps_mean == (0 + 1 + 1 + 2) / 4
    assert figures.age_steps_mean_at_source == (0 + 0 + 0 + 1) / 4
    assert figures.age_steps_by_source[0] == figures.age_steps_mean
    assert np.isnan(figures.age_steps_by_source[1])
    assert (figures.checkpoint_share, figures.records_per_share) == (0.25, 0.5)
    assert figures.body_bytes_per_step == 25.0


NODES, STEPS, PATH = 3, 8, [[1], [0, 2], [1]]


def spread_of(winners: tuple[int, ...], window: int) -> RecordSpread:
    """Return the records of a path of three nodes: the winner of a step sends all that it holds,
    and a node takes no record that is as old as the window is long."""
    arrival = np.full((NODES, STEPS, NODES), NEVER)
    held: list[set[tuple[int, int]]] = [set() for _ in range(NODES)]
    for step, winner in enumerate(winners):
        for node in range(NODES):
            held[node].add((step, node))
        for node in PATH[winner]:
            held[node] |= {one for one in held[winner] if step - one[0] < window}
        for node in range(NODES):
            for taken, source in held[node]:
                if arrival[node, taken, source] == NEVER:
                    arrival[node, taken, source] = step
    return RecordSpread(
        np.ones((STEPS, NODES), dtype=bool), arrival, window, np.zeros(STEPS), STEPS, 0, 0
    )


def longest_gap(winners: tuple[int, ...], node: int) -> int:
    sends = [-1, *(step for step, one in enumerate(winners) if one == node), STEPS]
    return int(np.diff(sends).max())


def test_over_all_winners_a_record_comes_within_its_window_or_counts_as_lost():
    """A tiny network, every sequence of winners: the ages of records, with and without a wait that
    is bounded. A sequence and its mirror on the path have the same ages."""
    window, wait = 3, LongestWait(4, 4)
    bound = worst_contended_age_steps(dynamic_only(NODES, 1 / NODES), PATH, 1, wait)
    assert bound == 7
    within, served, complete = [], [], []
    for winners in product(range(NODES), repeat=STEPS):
        if winners > tuple(NODES - 1 - winner for winner in winners):
            continue
        narrow = spread_of(winners, window)
        within.append(min(record_lag_steps(narrow), window - 1))
        delays = narrow.arrival_steps - np.arange(STEPS)[:, None]
        assert delays[narrow.arrival_steps != NEVER].max() < window
        if max(longest_gap(winners, node) for node in range(NODES)) <= wait.first_cycles:
            wide = spread_of(winners, bound + 1)
            served.append(record_lag_steps(wide))
            complete.append(figures_of(wide).coverage)
    # The bound by the window is exact.
    assert max(within) == window - 1
    # Where no node waits for longer, a window that is longer than the bound loses nothing.
    assert bound - 1 <= max(served) <= bound
    assert min(complete) == 1.0


@pytest.mark.parametrize(
    ("window_steps", "arrival", "says"),
    [
        (
            2,
            1,
            "records: 100.00 % arrived within the window; an arrival took 1.00 steps in the mean",
        ),
        (
            9,
            1,
            "records: none was old enough yet to tell whether it arrived within the window; an ",
        ),
        (9, NEVER, "arrived within the window; none reached another node"),
    ],
)
def test_what_is_not_known_yet_is_a_sentence(window_steps: int, arrival: int, says: str):
    taken = np.array([[True, False], [False, False], [False, False]])
    arrivals = np.full((2, 3, 2), NEVER)
    arrivals[:, 0, 0] = [0, arrival]
    spread = RecordSpread(taken, arrivals, window_steps, np.array([8, 8, 8]), 3, 0, 3)
    told = words_of(figures_of(spread))
    assert says in told[0] and not any("nan" in line or "- arrived" in line for line in told)


def test_a_summary_tells_of_records_where_there_are_some():
    for rule, told in (("labelled", True), ("ci", False)):
        setup = setup_of(rule=rule)
        recorder = MemoryRecorder()
        drive(setup, recorder, lambda _: None)
        figures = summary_of(setup, read_trace(setup, recorder.messages))
        assert ("spread" in figures.details) == told
        assert any(line.startswith("records:") for line in details(figures)) == told
