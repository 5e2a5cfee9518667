"""Test the tracker: beside Stone Soup, in any order of arrival, and the existence of targets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from concord.features.several_targets.association.associate import joint_probabilities
from concord.features.several_targets.association.weights import Association, Weights
from concord.features.several_targets.tracking.tracker import Scan, track
from concord.features.several_targets.tracking.tracks import Tracks, no_tracks, reported
from concord.filters.interacting_models import Mode
from tests.features.several_targets.tracking.position_sensor import (
    PositionSensor,
    settings,
    tracks_at,
)
from tests.features.several_targets.tracking.stone_soup import StoneSoupTracker, crossing_targets

# The settings of a tracker whose targets are known to be there.
KNOWN = {
    "survival": 1.0, "birth": 0.0, "end_below": 0.0, "same_within": -1.0, "gate_probability": 0.99
}  # fmt: skip


def same_bits(one: Tracks, other: Tracks) -> bool:
    pairs = zip((*one.belief, *one[1:]), (*other.belief, *other[1:]), strict=True)
    return all(a.tobytes() == b.tobytes() and a.shape == b.shape for a, b in pairs)


@pytest.mark.parametrize("steps", [30, pytest.param(200, marks=pytest.mark.slow)])
def test_five_crossing_targets_agree_with_stone_soup(steps: int):
    sensor = PositionSensor(density=10 / 200**2)
    truth, scans = crossing_targets(steps, 5, 10, sensor, seed=4)
    tracks = tracks_at(truth[0])
    seen: list[Association] = []

    def associate(weights: Weights) -> Association:
        seen.append(joint_probabilities(weights))
        return seen[-1]

    known = settings("jpda", **KNOWN)._replace(associate=associate)
    peer = StoneSoupTracker(*tracks.belief, sensor, known.gate_probability)
    shared = 0
    for step, detections in enumerate(scans, start=1):
        ordered = detections[np.lexsort((detections[:, 1], detections[:, 0]))]
        tracks = track(tracks, [Scan(0, sensor, detections)], known, step).tracks
        hypotheses = peer.associated(ordered, step)
        found = np.column_stack((seen[-1].miss, seen[-1].hit))
        shared += ((found[:, 1:] > 0.01).sum(axis=0) > 1).any()
        np.testing.assert_allclose(found, peer.probabilities(hypotheses, ordered), atol=1e-9)
        mean, cov = peer.update(hypotheses)
        np.testing.assert_allclose(tracks.belief.mean, mean, atol=1e-6)
        np.testing.assert_allclose(tracks.belief.cov, cov, atol=1e-6)
    # The case is one of joint association: targets do share detections, and are not lost.
    assert shared > 3
    np.testing.assert_allclose(tracks.existence, 1, atol=1e-9)


@hypothesis_settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["jpda", "nearest"]), st.sampled_from([1, 2]))
def test_the_order_of_arrival_changes_no_bit(seed: int, association: str, models: int):
    rng = np.random.default_rng(seed)
    sensors = [PositionSensor(detection=0.8 + 0.05 * n, density=1e-4) for n in range(3)]
    usual = settings(association)
    if models == 2:
        usual = usual._replace(modes=(Mode(held=(1, 3), std=1.0), Mode()), change=0.1)
    one = other = usual.start.tracks
    targets = rng.uniform(-20, 20, (3, 2))
    for step in range(4):
        scans = []
        for number, sensor in enumerate(sensors):
            taken = targets + 2 * rng.standard_normal(targets.shape)
            # Equal detections are possible: a sensor has a resolution.
            clutter = np.round(rng.uniform(-30, 30, (4, 2)) / 10) * 10
            scans.append(Scan(number, sensor, np.concatenate((taken, clutter, clutter[:1]))))
        moved = [
            scan._replace(detections=rng.permutation(scan.detections))
            for scan in (scans[place] for place in rng.permutation(3))
        ]
        one = track(one, scans, usual, step).tracks
        other = track(other, moved, usual, step).tracks
        assert same_bits(one, other)
    assert len(one.existence)


def test_a_sensor_that_cannot_see_a_track_does_not_vote_it_down():
    tracks = tracks_at(np.array([[100.0, 0, 0, 0], [-100.0, 0, 0, 0]]), existence=0.9)
    blind = PositionSensor(reach=0.0)
    after = track(tracks, [Scan(0, blind, np.empty((0, 2)))], settings(survival=1.0), 1).tracks
    assert after.existence[0] == 0.9
    # r (1 - P) / (1 - r P) with P the probability of a detection within the gate.
    detected = blind.detection * settings().gate_probability
    assert after.existence[1] == pytest.approx(0.9 * (1 - detected) / (1 - 0.9 * detected))


def test_existence_follows_the_bayes_rule_of_one_track():
    sensor, usual = PositionSensor(), settings(survival=1.0, birth=0.0)
    tracks = tracks_at(np.array([[0.0, 0, 0, 0]]), existence=0.3)
    detection = np.array([[1.0, -2.0]])
    after = track(tracks, [Scan(0, sensor, detection)], usual, 1).tracks
    moved = tracks_at(np.array([[0.0, 0, 0, 0]])).belief.cov[0]
    transition = usual.transition(np.eye(4)).T
    moved = transition @ moved @ transition.T + usual.process_noise_cov
    innovation_cov = moved[::2, ::2] + sensor.noise_cov
    squared = detection[0] @ np.linalg.solve(innovation_cov, detection[0])
    likelihood = np.exp(-squared / 2) / np.sqrt(np.linalg.det(2 * np.pi * innovation_cov))
    missed = 1 - sensor.detection * usual.gate_probability
    there = 0.3 * (missed + sensor.detection * likelihood / sensor.density)
    assert after.existence[0] == pytest.approx(there / (there + 0.7))


def test_models_that_are_alike_are_one_tracker():
    rng, sensor = np.random.default_rng(8), PositionSensor(density=1e-3)
    plain = settings()
    alike = plain._replace(modes=(Mode(), Mode(), Mode()), change=0.2)
    one, several = plain.start.tracks, alike.start.tracks
    targets = np.array([[0.0, 0.0], [6.0, 0.0], [60.0, 0.0]])
    for step in range(12):
        taken = targets + [2.0 * step, 0] + 2 * rng.standard_normal(targets.shape)
        detections = np.concatenate((taken[rng.random(3) < 0.9], rng.uniform(-30, 90, (4, 2))))
        one = track(one, [Scan(0, sensor, detections)], plain, step).tracks
        several = track(several, [Scan(0, sensor, detections)], alike, step).tracks
        np.testing.assert_allclose(several.existence, one.existence, rtol=1e-9)
        for found, known in zip(alike.models.moments(several.belief), one.belief, strict=True):
            np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-9)
    assert len(one.existence) > 3


def test_one_scan_of_two_models_is_the_sum_over_models_and_detections():
    sensor, still = PositionSensor(detection=0.8), Mode(held=(1, 3), std=1.0)
    usual = settings(survival=1.0, birth=0.0)._replace(modes=(still, Mode()), change=0.1)
    belief = usual.begun(np.array([[0.0, 5, 0, -3]]), np.diag([9.0, 4, 9, 4])[None])
    before = Tracks(belief, np.array([0.6]), np.zeros((1, 3), dtype=int), np.ones(1, dtype=bool))
    detections = np.array([[1.0, -2.0], [4.0, -3.0]])
    after = track(before, [Scan(0, sensor, detections)], usual, 1).tracks
    moved = usual.models.predict(belief, usual.transition, usual.process_noise_cov)
    means, covs, logs = (part[0] for part in usual.models.apart(moved))
    weights, states, spreads = [], [], []
    for mean, cov, chance in zip(means, covs, np.exp(logs), strict=True):
        weights.append(chance * (1 - sensor.detection * usual.gate_probability))
        states.append(mean)
        spreads.append(cov)
        innovation_cov = cov[::2, ::2] + sensor.noise_cov
        gain = cov[:, ::2] @ np.linalg.inv(innovation_cov)
        for away in detections - mean[::2]:
            squared = away @ np.linalg.solve(innovation_cov, away)
            likelihood = np.exp(-squared / 2) / np.sqrt(np.linalg.det(2 * np.pi * innovation_cov))
            weights.append(chance * sensor.detection * likelihood / sensor.density)
            states.append(mean + gain @ away)
            spreads.append(cov - gain @ cov[::2])
    total = sum(weights)
    shares, states = np.array(weights) / total, np.array(states)
    mean = shares @ states
    away = states - mean
    cov = np.einsum("k,kij->ij", shares, np.array(spreads) + away[:, :, None] * away[:, None])
    found = usual.models.moments(after.belief)
    np.testing.assert_allclose(found.mean[0], mean, atol=1e-9)
    np.testing.assert_allclose(found.cov[0], cov, atol=1e-9)
    assert usual.models.probabilities(after.belief)[0, 0] == pytest.approx(shares[:3].sum())
    assert after.existence[0] == pytest.approx(0.6 * total / (0.6 * total + 0.4))


def test_targets_begin_are_confirmed_and_end():
    sensor, usual = PositionSensor(detection=0.95, density=1e-5), settings()
    rng = np.random.default_rng(5)
    tracks, numbers = no_tracks(4), []
    for step in range(40):
        place = np.array([[3.0 * step, 10.0]]) + 2 * rng.standard_normal((1, 2))
        detections = place if 5 <= step < 25 else np.empty((0, 2))
        tracks = track(tracks, [Scan(0, sensor, detections)], usual, step).tracks
        numbers.append(len(reported(tracks).existence))
        if numbers[-1]:
            assert tracks.identity[0].tolist() == [5, 0, 0]
    assert numbers[:5] == [0] * 5 and numbers[-1] == 0
    assert numbers[8:25] == [1] * 17
    assert max(numbers) == 1


def test_the_younger_of_two_tracks_of_one_target_ends():
    mean = np.array([[0.0, 0, 0, 0], [0.5, 0, 0, 0], [0.0, 20, 0, 0]])
    usual = settings(survival=1.0)
    after = track(tracks_at(mean), [], usual, 1).tracks
    # The third is at the same place, but leaves it fast.
    assert after.identity[:, 2].tolist() == [0, 2]


def test_a_track_that_is_not_seen_for_long_ends():
    tracks, steps = tracks_at(np.zeros((1, 4))), 0
    while len(tracks.existence):
        tracks, steps = track(tracks, [], settings(survival=1.0), steps).tracks, steps + 1
        spread = np.sqrt(tracks.belief.cov[:, [0, 2], [0, 2]].sum(axis=1))
        assert (spread <= settings().lost_above).all()
    assert 10 < steps < 60
