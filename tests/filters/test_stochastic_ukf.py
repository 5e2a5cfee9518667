"""Filters behind a measurement bus: second moments, the Kalman filter, the printed algorithm."""

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filters import kalman, ukf
from filters.gaussian import Gaussian
from filters.sigma_points import SigmaPointRule, scaled_unscented
from filters.stochastic_ukf import (
    RECOMMENDED,
    Dynamics,
    Observation,
    Received,
    State,
    expected_cov,
)
from filters.stochastic_ukf_printed import PAPER_LITERAL, PAPER_LITERAL_R, pseudo_inverse
from tests.filters.support import BATCHES, random_belief, random_spd

FILTERS = {
    "recommended": RECOMMENDED,
    "paper-literal": PAPER_LITERAL,
    "paper-literal-R": PAPER_LITERAL_R,
}
N, M = 2, 6
PAPER_POINTS = scaled_unscented(N, 1.0, 2.0, 0.0)


class Moment(NamedTuple):
    pi: np.ndarray
    gamma: np.ndarray


def nothing(size: int, states: int) -> Moment:
    return Moment(np.zeros((0, size, size)), np.zeros((0, states, states)))


def random_moment(generator: np.random.Generator, terms: int, size: int, states: int) -> Moment:
    return Moment(
        random_spd(generator, (terms,), size), 0.05 * random_spd(generator, (terms,), states)
    )


def paper_f(step: int, x: np.ndarray) -> np.ndarray:
    a, b = x[..., 0], x[..., 1]
    moved = [
        0.58 * a + 0.3 * np.cos(step) * a + 0.39 * b,
        0.28 * a + 0.2 * np.sin(step) * a + 0.52 * b,
    ]
    return np.stack(moved, axis=-1)


def paper_h(step: int, x: np.ndarray) -> np.ndarray:
    a, b = x[..., 0], x[..., 1]
    cosine, sine = np.cos(step), np.sin(step)
    seen = [
        0.36 * a + b * b, a * b + 0.16 * b, 0.8 * cosine * a + 0.36 * b,
        0.5 * a + a * b, 0.7 * cosine * a + 0.8 * b, 0.3 * a + 0.8 * sine * b,
    ]  # fmt: skip
    return np.stack(seen, axis=-1)


GAMMA = np.diag([0.04, 0.09])
PI_1 = np.array([[0.09, 0.06], [0.06, 0.04]])
U_1 = np.array([0.3, 0.2, 0.1, 0.1, 0.2, 0.3])
PROCESS = Moment(PI_1[None], GAMMA[None])
SENSING = Moment(np.outer(U_1, U_1)[None], GAMMA[None])


def paper_dynamics(step: int) -> Dynamics:
    return Dynamics(partial(paper_f, step), 0.05 * np.eye(N), PROCESS)


def paper_observation(step: int) -> Observation:
    return Observation(partial(paper_h, step), 0.01 * np.eye(M), SENSING)


def paper_run(seed: int, steps: int) -> tuple[Gaussian, np.ndarray, np.ndarray]:
    """Prior, ybar_s and what is fresh in slots 1..steps: 1 2 3 4, then 5 or 6 by chance."""
    generator = np.random.default_rng(seed)
    prior = Gaussian(np.array([5.0, -2.0]), np.eye(N))
    x = generator.multivariate_normal(*prior)
    held = paper_h(0, prior.mean)
    received, fresh = [], []
    for step in range(1, steps + 1):
        eta = generator.standard_normal(N) @ np.sqrt(GAMMA)
        x = paper_f(step - 1, x) + np.array([0.3, 0.2]) * (eta @ x)
        x = x + np.sqrt(0.05) * generator.standard_normal(N)
        zeta = generator.standard_normal(N) @ np.sqrt(GAMMA)
        y = paper_h(step, x) + U_1 * (zeta @ x) + 0.1 * generator.standard_normal(M)
        sender = (step - 1) % 5 if step % 5 else generator.integers(4, 6)
        mask = np.arange(M) == sender
        held = np.where(mask, y, held)
        received.append(held)
        fresh.append(mask)
    return prior, np.array(received), np.array(fresh)


def follow(method, prior: Gaussian, received, fresh, rule: SigmaPointRule = PAPER_POINTS) -> list:
    """The states at steps 0, 1, 2, ..."""
    states = [method.start(prior, paper_observation(0), rule)]
    for step, slot in enumerate(zip(received, fresh, strict=True), start=1):
        moved = method.predict(states[-1], paper_dynamics(step - 1), rule)
        states.append(method.update(moved, Received(*slot), paper_observation(step), rule))
    return states


# --- second moments ------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", BATCHES)
def test_expected_cov_is_the_mean_over_the_points_of_an_exact_rule(lanes: tuple[int, ...]):
    generator = np.random.default_rng(3)
    moment, belief = random_moment(generator, 3, 4, N), random_belief(generator, lanes, N)
    # x' G x is of degree 2, which the cubature points integrate exactly.
    root = np.linalg.cholesky(belief.cov)
    points = [belief.mean + sign * np.sqrt(N) * root[..., i] for i in range(N) for sign in (1, -1)]
    mean = sum(
        np.einsum("...i,ij,...j->...", x, gamma, x)[..., None, None] * pi / len(points)
        for x in points
        for pi, gamma in zip(*moment, strict=True)
    )
    np.testing.assert_allclose(expected_cov(moment, belief), mean, rtol=1e-12, atol=1e-14)


def test_no_terms_are_no_covariance():
    belief = random_belief(np.random.default_rng(1), (4,), N)
    np.testing.assert_array_equal(expected_cov(nothing(3, N), belief), np.zeros((4, 3, 3)))


@given(st.integers(0, 2**20))
def test_predicted_covariance_is_the_exact_second_moment(seed: int):
    """For linear f, E{x x'} obeys M' = A M A' + Q + sum Pi tr(Gamma M), whatever the law of x."""
    generator = np.random.default_rng(seed)
    matrix, moment = generator.standard_normal((N, N)), random_moment(generator, 2, N, N)
    noise_cov, belief = random_spd(generator, (), N), random_belief(generator, (), N)
    dynamics = Dynamics(lambda x: x @ matrix.T, noise_cov, moment)
    after = RECOMMENDED.predict(State(belief), dynamics, PAPER_POINTS).belief
    second = np.outer(belief.mean, belief.mean) + belief.cov
    expected = matrix @ second @ matrix.T + noise_cov
    for pi, gamma in zip(*moment, strict=True):
        expected = expected + pi * np.trace(gamma @ second)
    measured = np.outer(after.mean, after.mean) + after.cov
    np.testing.assert_allclose(measured, expected, rtol=1e-9, atol=1e-9)


# --- recommended ---------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", BATCHES)
def test_without_stochastic_terms_it_is_the_kalman_filter_of_what_was_sent(lanes):
    generator = np.random.default_rng(7)
    transition, rows = generator.standard_normal((N, N)), generator.standard_normal((M, N))
    process_cov, noise_cov = random_spd(generator, (), N), random_spd(generator, (), M)
    dynamics = Dynamics(lambda x: x @ transition.T, process_cov, nothing(N, N))
    observation = Observation(lambda x: x @ rows.T, noise_cov, nothing(M, N))
    belief = random_belief(generator, lanes, N)
    values = generator.standard_normal((*lanes, M))
    sent = np.array([False, True, True, False, False, True])
    state = RECOMMENDED.start(belief, observation, PAPER_POINTS)
    state = RECOMMENDED.predict(state, dynamics, PAPER_POINTS)
    fresh = np.broadcast_to(sent, values.shape)
    state = RECOMMENDED.update(state, Received(values, fresh), observation, PAPER_POINTS)
    moved = kalman.predict(belief, transition, process_cov)
    known = kalman.update(
        moved,
        values[..., sent],
        rows[sent],
        noise_cov[np.ix_(sent, sent)],  # pyright: ignore[reportCallIssue]
    ).belief
    np.testing.assert_allclose(state.belief.mean, known.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state.belief.cov, known.cov, rtol=1e-9, atol=1e-9)


def test_a_vector_valued_sensor_is_updated_as_a_block():
    """R and E{b b'} correlate its entries; it is as if no other sensor existed."""
    generator = np.random.default_rng(11)
    belief, values = random_belief(generator, (), N), generator.standard_normal(M)
    noise_cov, moment = random_spd(generator, (), M), random_moment(generator, 2, M, N)
    block = slice(2, 5)
    fresh = np.zeros(M, dtype=bool)
    fresh[block] = True
    observation = Observation(partial(paper_h, 3), noise_cov, moment)
    after = RECOMMENDED.update(State(belief), Received(values, fresh), observation, PAPER_POINTS)
    block_cov = (noise_cov + expected_cov(moment, belief))[block, block]
    alone = ukf.update(
        belief, values[block], lambda x: paper_h(3, x)[..., block], block_cov, PAPER_POINTS
    ).belief
    np.testing.assert_allclose(after.belief.mean, alone.mean, rtol=1e-10)
    np.testing.assert_allclose(after.belief.cov, alone.cov, rtol=1e-10)


def test_held_values_do_not_matter_and_nothing_sent_changes_nothing():
    prior, received, fresh = paper_run(5, 20)
    held_otherwise = np.where(fresh, received, 1e6)
    ours, theirs = (
        follow(RECOMMENDED, prior, values, fresh)[-1].belief
        for values in (received, held_otherwise)
    )
    np.testing.assert_array_equal(ours.mean, theirs.mean)
    silent = Received(received[0], np.zeros(M, dtype=bool))
    kept = RECOMMENDED.update(State(prior), silent, paper_observation(1), PAPER_POINTS)
    np.testing.assert_array_equal(kept.belief.mean, prior.mean)
    np.testing.assert_array_equal(kept.belief.cov, prior.cov)


def test_a_known_constant_drops_out():
    """Erratum E2: with the held values in place of their old predictions, in (17) as in (18), the
    printed equations and a pseudo-inverse give the recommended update."""
    prior, received, fresh = paper_run(2, 8)
    states = follow(RECOMMENDED, prior, received, fresh)
    moved = RECOMMENDED.predict(states[-1], paper_dynamics(8), PAPER_POINTS).belief
    values, sent = received[0] + 0.1, np.arange(M) == 3
    root = np.linalg.cholesky(N * moved.cov)
    points = [moved.mean, *(moved.mean + s * root[:, i] for s in (1, -1) for i in range(N))]
    weights = [2.0, *[1 / (2 * N)] * 4]
    outputs = [np.where(sent, paper_h(9, x), values) for x in points]
    output = sum(0.25 * y for y in outputs[1:])
    noise = 0.01 * np.eye(M) + expected_cov(SENSING, moved)
    output_cov = np.outer(sent, sent) * noise
    cross_cov = np.zeros((N, M))
    for weight, x, y in zip(weights, points, outputs, strict=True):
        output_cov = output_cov + weight * np.outer(y - output, y - output)
        cross_cov = cross_cov + weight * np.outer(x - moved.mean, y - output)
    gain = cross_cov @ np.linalg.pinv(output_cov)
    after = RECOMMENDED.update(
        State(moved), Received(values, sent), paper_observation(9), PAPER_POINTS
    ).belief
    np.testing.assert_allclose(after.mean, moved.mean + gain @ (values - output), rtol=1e-9)
    np.testing.assert_allclose(after.cov, moved.cov - gain @ output_cov @ gain.T, rtol=1e-9)


# --- as printed ----------------------------------------------------------------------------------


def printed(prior: Gaussian, received, fresh, invert, noise_everywhere: bool) -> list[Gaussian]:
    """Algorithm 1 in loops over points and matrices N, Theta; alpha = 1: gamma = 0."""
    mean_weights = [0.0, *[1 / (2 * N)] * (2 * N)]
    cov_weights = [2.0, *[1 / (2 * N)] * (2 * N)]

    def points(mean, cov):
        root = np.linalg.cholesky(N * cov)
        return [
            mean,
            *(mean + root[:, i] for i in range(N)),
            *(mean - root[:, i] for i in range(N)),
        ]

    def average(values):
        return sum(w * v for w, v in zip(mean_weights, values, strict=True))

    def spread(left, right):
        triples = zip(cov_weights, left, right, strict=True)
        return sum(w * np.outer(a, b) for w, a, b in triples)

    def scale(mean, cov):
        return mean @ GAMMA @ mean + np.trace(GAMMA @ cov)

    mean, cov = prior
    old_outputs = [paper_h(0, x) for x in points(mean, cov)]
    beliefs = []
    for s, (ybar, mask) in enumerate(zip(received, fresh, strict=True)):
        chi_hat = [paper_f(s, x) for x in points(mean, cov)]
        predicted = average(chi_hat)
        deviations = [x - predicted for x in chi_hat]
        predicted_cov = spread(deviations, deviations) + PI_1 * scale(mean, cov) + 0.05 * np.eye(N)
        outputs = [paper_h(s + 1, x) for x in points(predicted, predicted_cov)]
        pick = np.diag(mask.astype(float))
        keep = np.eye(M) - pick
        outputs_f = [pick @ new + keep @ old for new, old in zip(outputs, old_outputs, strict=True)]
        output_f = pick @ average(outputs) + keep @ average(old_outputs)
        errors = [y - output_f for y in outputs_f]
        noise = np.outer(U_1, U_1) * scale(predicted, predicted_cov) + 0.01 * np.eye(M)
        noise = noise if noise_everywhere else pick @ noise @ pick.T
        output_cov = spread(errors, errors) + noise
        gain = spread(deviations, errors) @ invert(output_cov)
        mean = predicted + gain @ (ybar - output_f)
        cov = predicted_cov - gain @ output_cov @ gain.T
        old_outputs = outputs
        beliefs.append(Gaussian(mean, cov))
    return beliefs


def moore_penrose(matrix: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(matrix, rcond=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_paper_literal_is_the_printed_algorithm_with_a_pseudo_inverse(seed: int):
    prior, received, fresh = paper_run(seed, 12)
    expected = printed(prior, received, fresh, moore_penrose, False)
    states = follow(PAPER_LITERAL, prior, received, fresh)[1:]
    for state, belief in zip(states, expected, strict=True):
        np.testing.assert_allclose(state.belief.mean, belief.mean, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(state.belief.cov, belief.cov, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_paper_literal_r_is_the_same_with_noise_on_all_rows(seed: int):
    prior, received, fresh = paper_run(seed, 30)
    expected = printed(prior, received, fresh, np.linalg.inv, True)
    states = follow(PAPER_LITERAL_R, prior, received, fresh)[1:]
    for state, belief in zip(states, expected, strict=True):
        np.testing.assert_allclose(state.belief.mean, belief.mean, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(state.belief.cov, belief.cov, rtol=1e-7, atol=1e-8)


def test_the_printed_covariance_is_singular_and_learns_nothing():
    """Errata E1 and bottom line: rank at most 2n+1, P_s|s = Q + E{g g'}, fresh gain zero."""
    prior, received, fresh = paper_run(4, 40)
    states = follow(PAPER_LITERAL, prior, received, fresh)
    noise_cov = 0.05 * np.eye(N)
    for before, after in pairwise(states):
        # On average over the wanderings of a singular matrix: to its rounding, not to a bit.
        expected = noise_cov + expected_cov(PROCESS, before.belief)
        np.testing.assert_allclose(after.belief.cov, expected, atol=1e-9)
    pushed = received.copy()
    pushed[-1] += 0.5 * fresh[-1]
    again = follow(PAPER_LITERAL, prior, pushed, fresh)
    np.testing.assert_allclose(again[-1].belief.mean, states[-1].belief.mean, atol=1e-9)
    better, pushed_better = (
        follow(RECOMMENDED, prior, values, fresh)[-1].belief.mean for values in (received, pushed)
    )
    assert np.abs(better - pushed_better).max() > 0.01


def test_the_rank_of_the_printed_covariance():
    seen = []

    def watch(matrix):
        seen.append(np.linalg.matrix_rank(matrix, rtol=1e-10))
        return moore_penrose(matrix)

    prior, received, fresh = paper_run(6, 30)
    printed(prior, received, fresh, watch, False)
    assert max(seen) <= 2 * N + 1 < M


@pytest.mark.parametrize("lanes", [(3,), (2, 2)])
def test_pseudo_inverse_in_lanes(lanes: tuple[int, ...]):
    generator = np.random.default_rng(5)
    thin = generator.standard_normal((*lanes, M, 3))
    matrix = thin @ thin.mT
    inverse = pseudo_inverse(matrix)
    np.testing.assert_allclose(matrix @ inverse @ matrix, matrix, atol=1e-9)
    np.testing.assert_allclose(inverse @ matrix @ inverse, inverse, atol=1e-9)
    matrix[0] = np.nan
    broken = pseudo_inverse(matrix)
    assert np.isnan(broken[0]).all()
    np.testing.assert_array_equal(broken[1:], inverse[1:])


# --- lanes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILTERS)
def test_a_batch_is_its_lanes_and_a_broken_lane_breaks_alone(name: str):
    runs = [paper_run(seed, 10) for seed in range(4)]
    prior = Gaussian(np.array([r[0].mean for r in runs]), np.array([r[0].cov for r in runs]))
    prior.cov[3] = -np.eye(N)
    received, fresh = (np.stack([r[i] for r in runs], axis=1) for i in (1, 2))
    together = follow(FILTERS[name], prior, received, fresh)[-1].belief
    assert np.isnan(together.mean[3]).all() and np.isnan(together.cov[3]).all()
    for lane in range(3):
        alone = follow(FILTERS[name], runs[lane][0], received[:, lane], fresh[:, lane])[-1].belief
        np.testing.assert_allclose(together.mean[lane], alone.mean, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(together.cov[lane], alone.cov, rtol=1e-7, atol=1e-9)


def test_only_what_needs_a_warning_has_one():
    warned = {name for name, method in FILTERS.items() if method.warning}
    assert warned == {"paper-literal", "paper-literal-R"}
    assert "singular" in PAPER_LITERAL.warning and "zero gain" in PAPER_LITERAL.warning
