"""The UKF under the FlexRay protocol as printed: against loops over points, and its errata."""

from itertools import pairwise

import numpy as np
import pytest

from concord.features.measurement_bus.stochastic_ukf import RECOMMENDED, expected_cov
from concord.filters.gaussian import Gaussian
from concord.papers.meng2025.filter_as_printed import PAPER_LITERAL, PAPER_LITERAL_R, pseudo_inverse
from tests.features.measurement_bus.measurement_runs import (
    GAMMA,
    PI_1,
    PROCESS,
    U_1,
    M,
    N,
    follow,
    paper_f,
    paper_h,
    paper_run,
)


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


@pytest.mark.parametrize("method", [RECOMMENDED, PAPER_LITERAL, PAPER_LITERAL_R])
def test_a_batch_is_its_lanes_and_a_broken_lane_breaks_alone(method):
    runs = [paper_run(seed, 10) for seed in range(4)]
    prior = Gaussian(np.array([r[0].mean for r in runs]), np.array([r[0].cov for r in runs]))
    prior.cov[3] = -np.eye(N)
    received, fresh = (np.stack([r[i] for r in runs], axis=1) for i in (1, 2))
    together = follow(method, prior, received, fresh)[-1].belief
    assert np.isnan(together.mean[3]).all() and np.isnan(together.cov[3]).all()
    for lane in range(3):
        alone = follow(method, runs[lane][0], received[:, lane], fresh[:, lane])[-1].belief
        np.testing.assert_allclose(together.mean[lane], alone.mean, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(together.cov[lane], alone.cov, rtol=1e-7, atol=1e-9)
