"""Test interacting multiple models beside sums over all histories of models."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.filters.extended import ExtendedFilter
from concord.filters.gaussian import Gaussian, stacked_blocks
from concord.filters.interacting_models import InteractingModels, Mode
from concord.filters.linalg import pack_upper
from concord.filters.sigma_point_filter import SigmaPointFilter
from concord.filters.sigma_points import scaled_unscented
from concord.nodes.share_forms import StackedBelief
from concord.plants.motion import TURN_RATE, CoordinatedTurn

F = np.array([[1.0, 0.7], [0.0, 0.9]])
Q, R, H = np.diag([0.2, 0.1]), np.array([[0.5]]), np.array([[1.0, 0.0]])
PRIOR = Gaussian(np.array([0.3, 1.0]), np.array([[2.0, 0.3], [0.3, 1.0]]))
STD, CHANGE = 0.8, 0.2
LINEAR = ExtendedFilter(1.0)


def models(change: float = CHANGE, modes: tuple[Mode, ...] = (Mode((1,), STD), Mode())):
    return InteractingModels(LINEAR, 2, modes, change)


def predicted(filter: InteractingModels, belief: Gaussian) -> Gaussian:
    return filter.predict(belief, lambda points: points @ F.T, Q)


def updated(filter: InteractingModels, belief: Gaussian, value: float, **others) -> Gaussian:
    reading = np.array([value])
    return filter.update(belief, reading, lambda points: points @ H.T, R, **others).belief


def exact(readings: list[float], steps: int) -> tuple[np.ndarray, Gaussian]:
    """Probabilities of the last model, and the moments of the last state: the sum over all
    histories of models, each by the joint normal distribution of its last state and readings."""
    held = np.diag([1.0, 0.0])
    moves = (held @ F @ held, held @ Q @ held + np.diag([0.0, STD**2])), (F, Q)
    weights, parts = [], []
    for history in itertools.product((0, 1), repeat=steps + 1):
        # The state of each step as a linear map of prior and noises, all of them in one vector.
        size = 2 * (steps + 1)
        cov, mean = np.zeros((size, size)), np.zeros(size)
        cov[:2, :2], mean[:2] = PRIOR.cov, PRIOR.mean
        rows, probability = np.eye(2, size), 0.5
        seen = [H @ rows]
        for step, (before, model) in enumerate(itertools.pairwise(history), 1):
            move, noise = moves[model]
            probability *= CHANGE if before != model else 1 - CHANGE
            places = slice(2 * step, 2 * step + 2)
            cov[places, places] = noise
            rows = move @ rows
            rows[:, places] += np.eye(2)
            seen.append(H @ rows)
        taken = np.concatenate(seen)[: len(readings)]
        joint = taken @ cov @ taken.T + R * np.eye(len(taken))
        gain = rows @ cov @ taken.T @ np.linalg.inv(joint)
        away = np.array(readings) - taken @ mean
        distance = away @ np.linalg.solve(joint, away)
        probability *= np.exp(-distance / 2) / np.sqrt(np.linalg.det(2 * np.pi * joint))
        weights.append((history[-1], probability))
        state_cov = rows @ cov @ rows.T
        parts.append((rows @ mean + gain @ away, state_cov - gain @ joint @ gain.T))
    share = np.array([weight for _, weight in weights])
    share /= share.sum()
    last = np.array([model for model, _ in weights])
    mean = share @ np.array([m for m, _ in parts])
    spread = np.array([p + np.outer(m - mean, m - mean) for m, p in parts])
    cov = np.einsum("h,hij->ij", share, spread)
    return np.array([share[last == 0].sum(), share[last == 1].sum()]), Gaussian(mean, cov)


def filtered(readings: list[float], steps: int, filter: InteractingModels) -> Gaussian:
    belief = filter.begun(PRIOR)
    for step in range(steps + 1):
        belief = predicted(filter, belief) if step else belief
        belief = updated(filter, belief, readings[step]) if step < len(readings) else belief
    return belief


@pytest.mark.parametrize(("count", "steps"), [(1, 0), (1, 1), (2, 1), (2, 2)])
def test_first_steps_are_the_sum_over_all_histories(count: int, steps: int):
    # The models of a step differ in one way, so nothing is merged before the second prediction,
    # which keeps moments and probabilities.
    readings = [1.0, 3.5][:count]
    probabilities, moments = exact(readings, steps)
    filter = models()
    belief = filtered(readings, steps, filter)
    assert filter.probabilities(belief) == pytest.approx(probabilities, rel=1e-9)
    for found, known in zip(filter.moments(belief), moments, strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-9, atol=1e-12)


def test_later_steps_are_near_the_sum_over_all_histories():
    readings = [1.0, 3.5, 4.0, 3.2, 5.5, 5.6]
    probabilities, moments = exact(readings, 5)
    filter = models()
    belief = filtered(readings, 5, filter)
    assert filter.probabilities(belief) == pytest.approx(probabilities, abs=0.02)
    np.testing.assert_allclose(filter.moments(belief).mean, moments.mean, atol=0.05)
    np.testing.assert_allclose(filter.moments(belief).cov, moments.cov, atol=0.05)


@pytest.mark.parametrize("modes", [(Mode(),), (Mode(), Mode()), (Mode(), Mode(), Mode())])
def test_models_that_are_alike_are_one_filter(modes: tuple[Mode, ...]):
    filter, belief = models(modes=modes), PRIOR
    mixture = filter.begun(PRIOR)
    for value in (1.0, 3.5, 2.0, 7.0):
        belief = LINEAR.predict(belief, lambda points: points @ F.T, Q)
        belief = LINEAR.update(belief, np.array([value]), lambda points: points @ H.T, R).belief
        mixture = updated(filter, predicted(filter, mixture), value)
    for found, known in zip(filter.moments(mixture), belief, strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-12)
    assert filter.probabilities(mixture) == pytest.approx(np.full(len(modes), 1 / len(modes)))


@given(
    st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=6),
    st.floats(1e-6, 1 - 1e-6),
    st.floats(1e-3, 1e3),
)
@settings(max_examples=60, deadline=None)
def test_probabilities_sum_to_one_and_covariances_are_positive(
    readings: list[float], change: float, std: float
):
    filter = models(change, (Mode((1,), std), Mode()))
    belief = filtered(readings, len(readings), filter)
    probabilities = filter.probabilities(belief)
    assert probabilities.sum() == pytest.approx(1) and (probabilities >= 0).all()
    assert (belief.cov[~stacked_blocks(2, 2)] == 0).all() and belief.cov[-1, -1] == 1
    assert np.isfinite(belief.mean).all()
    assert (np.linalg.eigvalsh(filter.moments(belief).cov) > 0).all()


def test_lanes_are_apart_and_nothing_taken_or_gated_keeps_the_bits():
    filter = models()
    lanes = Gaussian(np.stack([PRIOR.mean] * 4), np.stack([PRIOR.cov, PRIOR.cov * np.nan] * 2))
    belief = predicted(filter, filter.begun(lanes))
    readings = np.array([[1.0], [1.0], [np.nan], [1e6]])
    after = filter.update(belief, readings, lambda points: points @ H.T, R, gate=30.0)
    alone = updated(filter, predicted(filter, filter.begun(PRIOR)), 1.0)
    np.testing.assert_allclose(after.belief.mean[0], alone.mean, rtol=1e-12)
    assert np.isnan(after.belief.mean[1]).any()
    for found, before in zip(after.belief, belief, strict=True):
        np.testing.assert_array_equal(found[2], before[2])
    assert after.normalised_innovation_squared[2] == 0 and np.isnan(after.innovation[2]).all()
    whole = models(modes=(Mode((1,), STD), Mode()))
    sound = predicted(whole, whole.begun(PRIOR))
    np.testing.assert_array_equal(updated(whole, sound, 1e6, gate=30.0).mean, sound.mean)


def test_a_belief_of_several_models_travels_without_what_is_known_of_it():
    filter = models()
    belief = filtered([1.0, 3.5], 2, filter)
    numbers = np.concatenate((belief.mean, pack_upper(belief.cov)))
    exactly, single = StackedBelief(2, 2, False), StackedBelief(2, 2, True)
    # Two means of 2, one ratio of odds, two triangles of 3, and its variance.
    assert exactly.length == 5 + 7 and len(numbers) == 5 + 15
    np.testing.assert_array_equal(exactly.numbers(exactly.codes(numbers)), numbers)
    rounded = single.codes(numbers)
    assert rounded.dtype == np.float32
    np.testing.assert_allclose(single.numbers(rounded), numbers, rtol=1e-6)


def test_a_target_that_begins_to_turn_is_followed_better_than_by_one_model():
    # 200 targets go straight for 40 steps, turn at 0.1 rad/s for 20, and go straight again.
    generator, motion = np.random.default_rng(5), CoordinatedTurn()
    rule = scaled_unscented(5)
    one, filter = SigmaPointFilter(rule), InteractingModels(
        SigmaPointFilter(rule), 5, (Mode((TURN_RATE,), 0.1), Mode()), 0.05
    )  # fmt: skip
    truth = np.tile([0.0, 10.0, 0.0, 0.0, 0.0], (200, 1))
    start = truth + generator.standard_normal(truth.shape) * [20, 3, 20, 3, 0.02]
    single = Gaussian(start, np.tile(np.diag([400.0, 9, 400, 9, 4e-4]), (200, 1, 1)))
    mixture = filter.begun(single)
    noise, squares, turning = motion.process_noise_cov(0), [], []
    for step in range(80):
        truth[:, TURN_RATE] = 0.1 * (40 <= step < 60)
        truth = motion.transition(truth, None, step)
        reading = truth[:, [0, 2]] + 10 * generator.standard_normal((200, 2))

        def moved(points: np.ndarray) -> np.ndarray:
            return motion.transition(points, None, 0)

        def seen(points: np.ndarray) -> np.ndarray:
            return points[..., [0, 2]]

        single = one.update(
            one.predict(single, moved, noise), reading, seen, 100 * np.eye(2)
        ).belief
        mixture = filter.update(
            filter.predict(mixture, moved, noise), reading, seen, 100 * np.eye(2)
        ).belief
        away = [b.mean[:, [0, 2]] - truth[:, [0, 2]] for b in (single, filter.moments(mixture))]
        squares.append([(one**2).sum(axis=1).mean() for one in away])
        turning.append(filter.probabilities(mixture)[:, 1].mean())
    alone, interacting = np.sqrt(np.mean(squares[10:], axis=0))
    assert interacting < 0.9 * alone
    assert np.mean(turning[20:40]) < 0.4 and np.mean(turning[50:60]) > 0.7
