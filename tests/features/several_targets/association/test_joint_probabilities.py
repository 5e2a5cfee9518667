"""Test joint probabilities, nearest neighbours and best hypotheses against all that there are."""

from itertools import product

import networkx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.several_targets.association import associate
from concord.features.several_targets.association.associate import (
    ASSOCIATIONS,
    clusters,
    joint_probabilities,
)
from concord.features.several_targets.association.best_hypotheses import (
    MISSED,
    best_hypotheses,
    best_hypothesis,
)
from concord.features.several_targets.association.weights import Weights


def every_hypothesis(weights: Weights) -> list[tuple[tuple[int, ...], float]]:
    """All joint hypotheses with their weights, by their definition."""
    tracks, detections = weights.hit.shape
    found = []
    for chosen in product(range(MISSED, detections), repeat=tracks):
        taken = [one for one in chosen if one != MISSED]
        if len(set(taken)) == len(taken):
            factors = [
                weights.miss[t] if d == MISSED else weights.hit[t, d] for t, d in enumerate(chosen)
            ]
            found.append((chosen, float(np.prod(factors))))
    return [one for one in found if one[1] > 0]


def enumerated(weights: Weights) -> np.ndarray:
    hit = np.zeros_like(weights.hit)
    hypotheses = every_hypothesis(weights)
    for chosen, weight in hypotheses:
        for track, detection in enumerate(chosen):
            if detection != MISSED:
                hit[track, detection] += weight
    return hit / sum(weight for _, weight in hypotheses)


@st.composite
def small_weights(draw: st.DrawFn) -> Weights:
    tracks, detections = draw(st.integers(1, 4)), draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    hit = np.exp(rng.uniform(-8, 8, (tracks, detections)))
    hit[rng.random(hit.shape) < draw(st.sampled_from([0.0, 0.4, 0.8]))] = 0
    return Weights(rng.uniform(0.01, 1, tracks), hit)


@given(small_weights())
def test_joint_probabilities_are_those_of_all_hypotheses(weights: Weights):
    found = joint_probabilities(weights)
    np.testing.assert_allclose(found.hit, enumerated(weights), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(found.miss + found.hit.sum(axis=1), 1, rtol=1e-12)
    assert (found.hit.sum(axis=0) <= 1 + 1e-12).all() and found.approximated == 0


@given(small_weights())
def test_hypotheses_come_in_the_order_of_their_weights(weights: Weights):
    expected = sorted((weight for _, weight in every_hypothesis(weights)), reverse=True)
    chosen, log_weights = best_hypotheses(weights, 7)
    np.testing.assert_allclose(np.exp(log_weights), expected[:7], rtol=1e-10)
    assert len({tuple(one) for one in chosen.tolist()}) == len(chosen)
    np.testing.assert_array_equal(best_hypothesis(weights), chosen[0])
    nearest = ASSOCIATIONS["nearest"](weights)
    for track, detection in enumerate(chosen[0]):
        assert nearest.miss[track] == (detection == MISSED)
        assert nearest.hit[track].sum() == (detection != MISSED)


@given(small_weights(), st.integers(0, 2**32 - 1))
def test_probabilities_follow_a_permutation(weights: Weights, seed: int):
    rng = np.random.default_rng(seed)
    rows, columns = (rng.permutation(size) for size in weights.hit.shape)
    moved = Weights(weights.miss[rows], weights.hit[rows][:, columns])
    expected = joint_probabilities(weights).hit[rows][:, columns]
    np.testing.assert_allclose(joint_probabilities(moved).hit, expected, rtol=1e-11, atol=1e-14)


def test_the_best_hypotheses_stand_for_all_beyond_the_bound(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(3)
    weights = Weights(rng.uniform(0.05, 0.2, 3), np.exp(rng.uniform(-2, 2, (3, 3))))
    exact = joint_probabilities(weights)
    # All 34 hypotheses of three tracks and detections are among the hundred best.
    best = joint_probabilities(weights, exact_up_to=1)
    assert best.approximated == 1
    np.testing.assert_allclose(best.hit, exact.hit, rtol=1e-10)
    monkeypatch.setattr(associate, "BEST", 10)
    fewer = joint_probabilities(weights, exact_up_to=1)
    dropped = 1 - np.exp(best_hypotheses(weights, 10)[1]).sum() / sum(
        weight for _, weight in every_hypothesis(weights)
    )
    assert 0 < np.abs(fewer.hit - exact.hit).max() <= dropped / (1 - dropped)


def test_a_large_cluster_is_approximated_and_counted():
    weights = Weights(np.full(14, 0.1), np.exp(np.random.default_rng(1).normal(size=(14, 14))))
    found = joint_probabilities(weights)
    assert found.approximated == 1
    assert np.isfinite(found.hit).all()
    np.testing.assert_allclose(found.miss + found.hit.sum(axis=1), 1)


def test_the_best_hypothesis_stands_for_a_cluster_beyond_all_bounds():
    size = associate.BEST_UP_TO + 1
    weights = Weights(
        np.full(size, 0.1), np.exp(np.random.default_rng(1).normal(size=(size, size)))
    )
    found = joint_probabilities(weights)
    assert found.approximated == 1
    np.testing.assert_array_equal(found.hit, ASSOCIATIONS["nearest"](weights).hit)


def test_a_sum_beyond_a_float_falls_back_to_the_best_hypotheses():
    # All tracks want the one detection, and cannot miss: every hypothesis underflows.
    weights = Weights(np.full(5, 1e-200), np.array([[1.0]] * 5))
    found = joint_probabilities(weights)
    assert found.approximated == 1
    np.testing.assert_allclose(found.hit[:, 0], 0.2)


@given(st.integers(0, 6), st.integers(0, 6), st.integers(0, 2**32 - 1))
def test_clusters_are_connected_components(tracks: int, detections: int, seed: int):
    possible = np.random.default_rng(seed).random((tracks, detections)) < 0.3
    graph = networkx.Graph()
    graph.add_edges_from((f"t{t}", f"d{d}") for t, d in np.argwhere(possible).tolist())
    expected = {frozenset(part) for part in networkx.connected_components(graph)}
    found = [
        frozenset({f"t{t}" for t in one.tracks} | {f"d{d}" for d in one.detections})
        for one in clusters(possible)
    ]
    assert len(found) == len(expected) and set(found) == expected
