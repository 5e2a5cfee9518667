"""Sensors that move while the network runs: `set placement=...`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.filters.gaussian import Gaussian
from concord.nodes.history import History
from concord.plants.placement import site_text
from concord.plants.targets import turning_target
from concord.results.figures.summary import heard_by_all
from concord.results.records.runs import runs_of_trace
from concord.runtime.batched.build import build_network
from concord.scenarios.baselines import (
    BaselineContent,
    baseline_step,
    centralised,
    local_only,
)
from concord.scenarios.catalogue import definition_of
from concord.scenarios.moves import with_moves
from concord.scenarios.preparation import complete_settings, prepare, with_settings
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import INNOVATIONS, READINGS, simulate
from tests.experiments.support import scenario
from tests.nodes.changing import run, same_bits
from tests.nodes.networks import SEEDS, shuffled

NODES, STEPS, MOVED = 5, 12, 4
FIRST = np.array([[300.0, 300], [500, 300], [700, 300], [400, 500], [600, 500]])
PLACES = st.tuples(
    # One node is near the target's first steps: where no node ever sees it, no run begins.
    st.floats(450, 650), st.floats(200, 300), *(st.floats(200, 800) for _ in range(2 * NODES - 2))
).map(lambda values: np.array(values).reshape(NODES, 2))  # fmt: skip


def network(places: np.ndarray = FIRST, **options: object) -> Setup:
    asked: dict = {"graph": "complete", "rule": "ci", "schedule": "full", "steps": STEPS, **options}
    return prepare(scenario("target-tracking", placement=places, **asked))


def test_sensors_measure_from_where_they_stand():
    after = FIRST.copy()
    after[3] = 500, 400
    trace = run(network(), f"{MOVED} set placement=3@500/400")
    assert trace.history.moves == [(MOVED, site_text(after))]
    for step in range(STEPS):
        plant = turning_target(after if step >= MOVED else FIRST)
        exact = plant.observe(trace.truth[step], np.zeros((NODES, 1, 2)), step)
        off = (trace.readings[step] - exact)[..., 0, :] / plant.sensors.noise_std
        assert np.nanmax(np.abs(off)) < 5
    # From the place of the beginning nobody would see it so.
    stale = turning_target(FIRST).observe(trace.truth[-1], np.zeros((NODES, 1, 2)), 0)
    gap = (trace.readings[-1] - stale)[3, 0] / turning_target(FIRST).sensors.noise_std
    assert np.abs(gap).max() > 5


@settings(max_examples=4)
@given(PLACES)
def test_places_that_are_set_at_the_first_step_are_those_of_the_network(places: np.ndarray):
    moved = run(network(), f"0 set placement={site_text(places)}")
    assert same_bits(moved, run(network(places), "0 set rounds=3"))


@settings(max_examples=3)
@given(PLACES, PLACES, SEEDS)
def test_the_order_of_messages_does_not_matter(one: np.ndarray, other: np.ndarray, seed: int):
    lines = (f"3 set placement={site_text(one)}", f"5 set placement={site_text(other)}",
             "6 kill 2", "8 restart 2")  # fmt: skip
    assert same_bits(run(network(), *lines), run(network(), *lines, pick=shuffled(seed)))


@settings(max_examples=3)
@given(PLACES)
def test_the_filters_beside_the_network_take_the_sensors_where_they_stood(places: np.ndarray):
    """They are filters of the one placement up to the move, and go on as those of the other."""
    line = f"{MOVED} set placement={site_text(places)}"
    trace = run(network(), line)
    moved, scripted = with_moves(network(), trace.history.moves), network(changes=(line,))
    for filtered, nodes in ((centralised, range(NODES)), (local_only, [1])):
        steps = [baseline_step(network(there), list(nodes)) for there in (FIRST, places)]
        prior = Gaussian(np.array(moved.prior_mean), np.array(moved.prior_cov))
        content, expected = BaselineContent(prior), []
        for step, readings in enumerate(trace.readings):
            content = steps[step >= MOVED](content, step, readings, None)
            expected.append(content.belief.mean)
        for setup in (moved, scripted):
            mean = filtered(setup, trace.readings, None).mean
            alone = mean if filtered is centralised else mean[:, 1]
            np.testing.assert_allclose(alone, expected, rtol=1e-9)


def test_many_runs_are_judged_by_the_sensors_where_they_stood():
    line = f"{MOVED} set placement=3@500/400;0@650/350"
    histories = simulate(network(changes=(line,)), range(2), keep=(READINGS, INNOVATIONS))
    trace = run(network(), line)
    of_run = runs_of_trace(with_moves(network(), trace.history.moves), trace)
    assert histories.innovations is not None and of_run.innovations is not None
    np.testing.assert_allclose(histories.innovations.nis[0], of_run.innovations.nis[0], rtol=1e-9)
    # By the places of the beginning no reading would fit.
    stale = runs_of_trace(network(), trace)
    assert stale is not None
    heard = [heard_by_all(one) for one in (stale, of_run)]
    worst, best = (np.nanmean(one.innovations.nis) for one in heard if one is not None)
    assert best < 4 < 40 < worst


def test_the_links_of_a_geometric_graph_follow_the_places():
    setup = network(graph="geometric")
    told = complete_settings(setup, {}, {"placement": "4@900/500"})
    later = with_settings(setup, told)
    assert [4 in heard for heard in setup.neighbours] == [False, True, True, True, False]
    assert [4 in heard for heard in later.neighbours] == [False, False, True, False, False]
    trace = run(setup, f"{MOVED} set placement=4@900/500")
    for step, one in ((MOVED - 1, setup), (MOVED, later)):
        for node, heard in enumerate(one.neighbours):
            assert np.flatnonzero(trace.ages[step, node] >= 0).tolist() == sorted([*heard, node])
    # A graph that a user has set stays.
    kept = complete_settings(setup, {}, {"graph": "ring", "placement": "4@900/500"})
    assert with_settings(setup, kept).neighbours == [[1, 4], [0, 2], [1, 3], [2, 4], [0, 3]]


def test_moves_add_up():
    setup = network()
    once = complete_settings(setup, {}, {"placement": "0@310/300"})
    twice = complete_settings(setup, once, {"placement": "1@510/300"})
    after = FIRST.copy()
    after[:2, 0] += 10
    assert twice == {"placement": site_text(after)}
    assert complete_settings(setup, twice, {"rounds": 2}) == {**twice, "rounds": 2}


def test_a_drawing_is_told_as_its_sites():
    told = complete_settings(network(graph="complete"), {}, {"placement": 2})
    assert str(told["placement"]).startswith("at:")
    other = prepare(scenario("target-tracking", nodes=NODES, placement=2, steps=STEPS))
    there = with_settings(network(), told).scenario
    assert site_text(_places(there)) == site_text(_places(other.scenario))


def _places(of: Scenario) -> np.ndarray:
    places = definition_of(of).plant(of).positions(0)
    assert places is not None
    return places


@pytest.mark.parametrize(
    ("options", "asked", "said"),
    [
        ({}, "7@1/2", "'7' is no node of the network; write NODE@x/y with a NODE of 0 to 4"),
        ({}, "3@1", "two finite numbers in m"),
        ({}, "3@nan/1", "two finite numbers in m"),
        ({}, "at:1/2;3/4", "2 sites, and the network 5 nodes"),
        ({}, "file:sites.txt", "reads no files; write NODE@x/y"),
        ({}, "somewhere", "is neither the number of a drawing"),
        ({"graph": "geometric"}, "4@5000/5000", "3 pieces"),
        ({"links": "moving:400"}, "4@500/400", "--links moving:400 brings its own graph"),
        ({"scenario": "oscillator"}, "1@0/0", "belongs to"),
    ],
)
def test_places_that_cannot_be_are_refused_before_the_start(options: dict, asked: str, said: str):
    chosen = {"nodes": NODES, "graph": "path", "steps": STEPS, **options}
    name = chosen.pop("scenario", "target-tracking")
    with pytest.raises(ValueError, match=f"^--changes '3 set placement={asked}': .*{said}"):
        prepare(scenario(name, **chosen, changes=(f"3 set placement={asked}",)))


def test_arrays_keep_the_places():
    with pytest.raises(ValueError, match=r"other places .* no array form; use --driver in-process"):
        build_network(network(changes=("3 set placement=0@310/300",)), [0])


def test_a_history_without_moves_has_none():
    assert History(()).moves == []
