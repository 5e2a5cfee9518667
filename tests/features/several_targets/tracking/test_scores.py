"""Test OSPA, GOSPA and identity switches beside Stone Soup, and at their limits."""

from datetime import datetime, timedelta
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.several_targets.tracking.scores import (
    NOT_ASSIGNED,
    gospa,
    identity_switches,
    ospa,
)

START = datetime(2026, 1, 1)
CUTOFF = 5.0


def positions(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 12, (count, 2))


def soup_states(places: np.ndarray, step: int = 0) -> list:
    from stonesoup.types.state import State

    return [State(place[:, None], timestamp=START + timedelta(seconds=step)) for place in places]


sets = st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(0, 5))


@given(sets, st.sampled_from([1, 2]))
def test_gospa_and_its_parts_are_those_of_stone_soup(drawn: tuple[int, int, int], order: int):
    from stonesoup.metricgenerator.ospametric import GOSPAMetric

    seed, targets, tracks = drawn
    truth, estimates = positions(seed, targets), positions(seed + 1, tracks)
    found = gospa(truth, estimates, CUTOFF, order)
    if not targets + tracks:
        assert found[:4] == (0, 0, 0, 0)
        return
    metric = GOSPAMetric(c=CUTOFF, p=order)
    peer, _ = metric.compute_gospa_metric(soup_states(estimates), soup_states(truth))
    penalty = CUTOFF**order / 2
    parts = (found.distance, found.localisation, found.missed * penalty, found.false * penalty)
    expected = [peer.value[name] for name in ("distance", "localisation", "missed", "false")]
    np.testing.assert_allclose(parts, expected, rtol=1e-9, atol=1e-12)


@given(sets)
def test_ospa_of_order_1_is_that_of_stone_soup(drawn: tuple[int, int, int]):
    from stonesoup.metricgenerator.ospametric import OSPAMetric

    seed, targets, tracks = drawn
    truth, estimates = positions(seed, targets), positions(seed + 1, tracks)
    found = ospa(truth, estimates, CUTOFF, 1)
    if not targets + tracks:
        assert found == 0
        return
    metric = OSPAMetric(c=CUTOFF, p=1)
    peer = metric.compute_OSPA_distance(soup_states(estimates), soup_states(truth)).value
    assert found == pytest.approx(float(peer), rel=1e-9)


@given(sets)
def test_ospa_of_order_2_is_the_least_of_all_assignments(drawn: tuple[int, int, int]):
    """Stone Soup assigns by distances here and not by their squares, so its value may be more."""
    from stonesoup.metricgenerator.ospametric import OSPAMetric

    seed, targets, tracks = drawn
    truth, estimates = positions(seed, targets), positions(seed + 1, tracks)
    fewer, more = sorted((truth, estimates), key=len)
    if not len(more):
        return
    distances = np.minimum(np.linalg.norm(fewer[:, None] - more, axis=-1), CUTOFF)
    places = np.array(list(permutations(range(len(more)), len(fewer))), dtype=int)
    of_pairs = distances[np.arange(len(fewer)), places]
    least, nearest = (int(np.argmin((of_pairs**order).sum(axis=-1))) for order in (2, 1))
    missing = CUTOFF**2 * (len(more) - len(fewer))
    expected = np.sqrt(((of_pairs[least] ** 2).sum() + missing) / len(more))
    found = ospa(truth, estimates, CUTOFF, 2)
    assert found == pytest.approx(expected, rel=1e-9)
    metric = OSPAMetric(c=CUTOFF, p=2)
    peer = metric.compute_OSPA_distance(soup_states(estimates), soup_states(truth)).value
    assert found <= float(peer) * (1 + 1e-9)
    if least == nearest:
        assert found == pytest.approx(float(peer), rel=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_identity_switches_are_those_of_stone_soup(seed: int):
    from stonesoup.metricgenerator.ospametric import GOSPAMetric

    rng = np.random.default_rng(seed)
    assigned: list[dict[int, object]] = []
    measured, names, true, targets = [], [], [], []
    for step in range(8):
        truth = np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]])
        there = np.flatnonzero(rng.random(3) < 0.9)
        estimates = truth[rng.random(3) < 0.8]
        identities = rng.choice(["a", "b", "c", "d"], len(estimates), replace=False).tolist()
        found = gospa(truth[there], estimates, CUTOFF)
        assigned.append(
            {
                int(target): None if place == NOT_ASSIGNED else identities[place]
                for target, place in zip(there, found.assigned, strict=True)
            }
        )
        measured += soup_states(estimates, step)
        names += identities
        true += soup_states(truth[there], step)
        targets += there.tolist()
        if not (len(there) and len(estimates)):
            # Stone Soup has no identities for a step in which one of the sets is empty.
            assigned.pop()
            del measured[len(measured) - len(estimates) :], names[len(names) - len(estimates) :]
            del true[len(true) - len(there) :], targets[len(targets) - len(there) :]
    if len(assigned) < 2:
        return
    metric = GOSPAMetric(c=CUTOFF, p=1, switching_penalty=1.0)
    steps = metric.compute_over_time(measured, names, true, targets).value
    total = sum(one.value["switching"] for one in steps)
    assert identity_switches(assigned) == pytest.approx(float(total), rel=1e-9)


def test_a_target_far_from_its_track_is_missed_and_the_track_false():
    found = gospa(np.zeros((1, 2)), np.array([[CUTOFF, 0.0]]), CUTOFF)
    assert (found.missed, found.false, found.localisation) == (1, 1, 0)
    assert found.assigned.tolist() == [NOT_ASSIGNED]
    near = gospa(np.zeros((1, 2)), np.array([[CUTOFF - 1e-9, 0.0]]), CUTOFF)
    assert near.missed == near.false == 0
    assert near.distance == pytest.approx(found.distance)
