"""Filters behind a measurement bus: second moments and the Kalman filter."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.measurement_bus.stochastic_ukf import (
    RECOMMENDED,
    Dynamics,
    Observation,
    Received,
    State,
    expected_cov,
)
from concord.filters import ukf
from tests.features.measurement_bus.measurement_runs import (
    PAPER_POINTS,
    SENSING,
    M,
    Moment,
    N,
    follow,
    paper_dynamics,
    paper_h,
    paper_observation,
    paper_run,
)
from tests.filters import kalman
from tests.filters.support import BATCHES, random_belief, random_spd


def nothing(size: int, states: int) -> Moment:
    return Moment(np.zeros((0, size, size)), np.zeros((0, states, states)))


def random_moment(generator: np.random.Generator, terms: int, size: int, states: int) -> Moment:
    return Moment(
        random_spd(generator, (terms,), size), 0.05 * random_spd(generator, (terms,), states)
    )


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
