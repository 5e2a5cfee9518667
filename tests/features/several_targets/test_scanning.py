"""Test the scanning sensor and the swarm: their statistics, and the tracks that begin."""

import dataclasses
import itertools
import math

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from concord.features.several_targets.scanning import FALSE_ALARM, REFERENCE, ScanningSensor
from concord.features.several_targets.swarm import FASTEST_TURN_RAD_S, Swarm
from concord.plants.range_bearing import RangeBearing

PLACE = np.array([100.0, -50.0])


def sensor(**changed: float) -> ScanningSensor:
    return ScanningSensor(RangeBearing(PLACE), **changed)


def at_ranges(ranges: np.ndarray) -> np.ndarray:
    states = np.zeros((len(ranges), 4))
    states[:, 0], states[:, 2] = PLACE[0] + ranges * 0.6, PLACE[1] + ranges * 0.8
    return states


def test_detection_falls_with_range_and_ends_with_the_field():
    found = sensor(detection=0.8).detection_probability(
        at_ranges(350 * np.array([0.0, 0.3, REFERENCE, 0.9, 0.999, 1.001]))
    )
    assert found[0] == 1 and found[2] == pytest.approx(0.8) and found[5] == 0
    assert (np.diff(found) < 0).all() and found[4] > FALSE_ALARM


def test_a_target_is_detected_as_often_as_the_probability_says():
    radar = sensor(detection=0.7, clutter=0.0)
    rng, scans = np.random.default_rng(1), 4000
    states = at_ranges(np.array([150.0, 300.0, 400.0]))
    states[0, 0] = np.nan  # not there
    counts = np.zeros(2)
    for _ in range(scans):
        taken = radar.scan(states, rng)[:, 0]
        counts += (abs(taken - 300) < 60).sum(), len(taken)
    probability = radar.detection_probability(states[1:2])[0]
    assert counts[0] == counts[1]
    assert stats.binomtest(int(counts[0]), scans, probability).pvalue > 1e-3


@given(st.integers(0, 2**32 - 1), st.integers(0, 7))
def test_near_targets_give_one_detection_at_their_mean(seed: int, count: int):
    rng = np.random.default_rng(seed)
    exact = RangeBearing(PLACE, range_std_m=1e-9, bearing_std_rad=1e-9)
    radar = ScanningSensor(exact, 0.9, 0.0, field_of_view_m=1e6, merge_m=20.0)
    states = np.zeros((count, 4))
    states[:, ::2] = PLACE + rng.uniform(0, 60, (count, 2))
    # So wide is the field that every target is detected.
    taken = radar.scan(states, rng)
    graph = networkx.Graph()
    graph.add_nodes_from(range(count))
    for one, other in itertools.combinations(range(count), 2):
        if math.dist(states[one, ::2], states[other, ::2]) <= 20:
            graph.add_edge(one, other)
    groups = [states[[*group], ::2].mean(axis=0) for group in networkx.connected_components(graph)]
    along = np.stack((np.cos(taken[:, 1]), np.sin(taken[:, 1])), axis=-1)
    found = PLACE + taken[:, :1] * along
    np.testing.assert_allclose(sorted(found.tolist()), sorted(map(list, groups)), atol=1e-6)


def test_a_scan_says_nothing_beyond_its_reach():
    radar, states = sensor(), at_ranges(np.array([100.0, 199.0, 201.0]))
    cut = dataclasses.replace(radar, reach_m=200.0)
    seen, whole = (one.detection_probability(states) for one in (cut, radar))
    assert (seen[:2] == whole[:2]).all() and seen[2] == 0 < whole[2]
    assert cut.clutter_density(np.ones((1, 2))) == radar.clutter_density(np.ones((1, 2)))


def test_clutter_is_poisson_and_uniform_and_its_density_is_that():
    radar, rng = sensor(clutter=4.0), np.random.default_rng(2)
    scans = [radar.scan(np.empty((0, 4)), rng) for _ in range(3000)]
    counts = np.array([len(one) for one in scans])
    # Mean and variance of a Poisson number are equal.
    assert abs(counts.mean() - 4) < 4 * math.sqrt(4 / 3000)
    assert abs(counts.var() / counts.mean() - 1) < 0.15
    everything = np.concatenate(scans)
    assert stats.kstest((everything[:, 0] / 350) ** 2, "uniform").pvalue > 1e-3
    assert stats.kstest(everything[:, 1] / (2 * math.pi) + 0.5, "uniform").pvalue > 1e-3
    # The density integrates to the expected number over the field, but for the floor at its middle.
    ranges = np.linspace(0, 350, 3501)[:, None]
    density = radar.clutter_density(ranges)
    assert 2 * math.pi * np.trapezoid(density, ranges[:, 0]) == pytest.approx(4.0, rel=2e-3)


def test_tracks_begin_with_the_error_of_their_detection():
    radar, rng = sensor(clutter=0.0, detection=0.99), np.random.default_rng(3)
    state = at_ranges(np.array([200.0]))
    squared = []
    for _ in range(2000):
        detections = radar.scan(state, rng)
        if len(detections):
            mean, cov = radar.begun(detections)
            away = (mean - state)[0, ::2]
            squared.append(away @ np.linalg.solve(cov[0][::2, ::2], away))
    # Chi-square with 2 degrees of freedom: mean 2, variance 4.
    assert abs(np.mean(squared) - 2) < 4 * math.sqrt(4 / len(squared))


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"detection": 1.0}, "detection 1: must be above 0.001"),
        ({"clutter": -1.0}, "clutter -1"),
        ({"merge_m": math.inf}, "merge_m inf"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(changed: dict[str, float], says: str):
    with pytest.raises(ValueError, match=says):
        sensor(**changed)


def generators(seed: int):
    return lambda purpose, node: np.random.default_rng((seed, len(purpose), node))


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 120))
def test_targets_appear_move_and_disappear(seed: int, targets: int, steps: int):
    truth = Swarm(targets).truth(generators(seed), steps)
    there = np.asarray(np.isfinite(truth).all(axis=-1))
    assert truth.shape == (steps, targets, 4) and there.any(axis=0).all()
    assert there[0, ::2].all()
    # Each target is there for one stretch of steps.
    assert (np.abs(np.diff(there.astype(int), axis=0)).sum(axis=0) <= 2).all()
    speed = np.linalg.norm(truth[..., 1::2], axis=-1)
    assert (np.nanmax(speed, axis=0) - np.nanmin(speed, axis=0) < 1e-9).all()
    for path, one in zip(truth.swapaxes(0, 1), there.T, strict=True):
        moved = path[one]
        heading = np.unwrap(np.arctan2(moved[:, 3], moved[:, 1]))
        assert (np.abs(np.diff(heading)) <= FASTEST_TURN_RAD_S + 1e-9).all()
        assert (moved[:, ::2] > -100).all() and (moved[:, ::2] < 1100).all()


def test_a_target_does_not_depend_on_how_many_there_are():
    few, many = (Swarm(count).truth(generators(1), 40) for count in (2, 5))
    np.testing.assert_array_equal(few, many[:, :2])
