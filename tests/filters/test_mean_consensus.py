"""Rules that exchange readings and average means: diffusion, Kalman consensus, no fusion at all."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filters.fusion import diffusion, kalman_consensus
from filters.fusion.local import keep_own
from filters.gaussian import Gaussian
from tests.filters import kalman
from tests.filters.support import BATCHES, random_belief, random_spd

SEEDS = st.integers(0, 2**16)
LANES = st.sampled_from(BATCHES)


def neighbourhood(generator, lanes, count, n):
    """Priors (*lanes, count, n), sensors H (count, 1, n), R (count,), readings (*lanes, count)."""
    priors = random_belief(generator, (*lanes, count), n)
    H = generator.standard_normal((count, 1, n))
    R = generator.uniform(0.2, 2.0, count)
    return priors, H, R, generator.standard_normal((*lanes, count))


def said(priors: Gaussian, H, R, values, begin) -> np.ndarray:
    after = kalman.update(priors, values[..., None], H, R[:, None, None] * np.eye(1)).belief
    return begin(priors, after)


def own(priors: Gaussian) -> Gaussian:
    return Gaussian(priors.mean[..., 0, :], priors.cov[..., 0, :, :])


@given(lanes=LANES, count=st.integers(1, 4), n=st.integers(1, 3), seed=SEEDS)
def test_the_incremental_update_is_algorithm_1_of_the_source(lanes, count, n, seed):
    """One neighbour's reading after the other, in gain form."""
    generator = np.random.default_rng(seed)
    priors, H, R, values = neighbourhood(generator, lanes, count, n)
    numbers = said(priors, H, R, values, diffusion.begin)
    belief = diffusion.incremental(own(priors), numbers)
    for lane in np.ndindex(lanes):
        psi, P = priors.mean[lane][0], priors.cov[lane][0]
        for j in range(count):
            S = R[j] + H[j] @ P @ H[j].T
            psi = psi + P @ H[j].T @ np.linalg.solve(S, values[lane][j] - H[j] @ psi)
            P = P - P @ H[j].T @ np.linalg.solve(S, H[j] @ P)
        np.testing.assert_allclose(belief.mean[lane], psi, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(belief.cov[lane], P, rtol=1e-7, atol=1e-8)


@given(lanes=LANES, count=st.integers(1, 4), n=st.integers(1, 3), seed=SEEDS)
def test_kalman_consensus_is_algorithm_1_of_the_source(lanes, count, n, seed):
    generator = np.random.default_rng(seed)
    priors, H, R, values = neighbourhood(generator, lanes, count, n)
    heard = generator.random(count) < 0.7
    heard[0] = True
    numbers = said(priors, H, R, values, kalman_consensus.begin)
    numbers[..., ~heard, :] = np.nan
    belief = kalman_consensus.correct(own(priors), numbers, 0.2)
    for lane in np.ndindex(lanes):
        mean, P = priors.mean[lane][0], priors.cov[lane][0]
        y = sum(H[j].T @ values[lane][j : j + 1] / R[j] for j in range(count) if heard[j])
        S = sum(H[j].T @ H[j] / R[j] for j in range(count) if heard[j])
        M = np.linalg.inv(np.linalg.inv(P) + S)
        gamma = 0.2 / (np.sqrt(np.trace(P.T @ P)) + 1)
        pull = sum(priors.mean[lane][j] - mean for j in range(count) if heard[j])
        expected = mean + M @ (y - S @ mean) + gamma * P @ pull
        np.testing.assert_allclose(belief.mean[lane], expected, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(belief.cov[lane], M, rtol=1e-7, atol=1e-8)


@given(scale=st.floats(1e-6, 1e12), seed=SEEDS)
def test_the_pull_of_a_neighbour_never_exceeds_the_rate(scale, seed):
    """However uncertain the node is; so the rates of all neighbours together stay below 1."""
    generator = np.random.default_rng(seed)
    prior = Gaussian(np.zeros(2), scale * random_spd(generator, (), 2))
    far = Gaussian(generator.standard_normal(2), prior.cov)
    both = Gaussian(np.stack([prior.mean, far.mean]), np.stack([prior.cov, far.cov]))
    numbers = kalman_consensus.begin(both, both)
    moved = kalman_consensus.correct(prior, numbers, 0.25)
    assert np.linalg.norm(moved.mean) <= 0.25 * np.linalg.norm(far.mean) * (1 + 1e-9)


@given(count=st.integers(2, 6), seed=SEEDS)
def test_averaging_by_a_rate_is_a_row_of_the_laplacian(count, seed):
    generator = np.random.default_rng(seed)
    means = generator.standard_normal((2, count, 3))
    rate = 1 / count
    weights = np.array([1 - rate * (count - 1), *[rate] * (count - 1)])
    np.testing.assert_allclose(
        kalman_consensus.average(means, rate), weights @ means, rtol=0, atol=1e-12
    )
    silent = means.copy()
    silent[0, 1:] = np.nan
    np.testing.assert_array_equal(kalman_consensus.average(silent, rate)[0], means[0, 0])


@given(lanes=LANES, count=st.integers(1, 5), seed=SEEDS)
def test_a_convex_combination_stays_within_what_it_combines(lanes, count, seed):
    generator = np.random.default_rng(seed)
    means = generator.standard_normal((*lanes, count, 2))
    weights = generator.dirichlet(np.ones(count), lanes)
    means[..., 1:, :][generator.random((*lanes, count - 1)) < 0.3] = np.nan
    mixed = diffusion.combine(means, weights)
    assert (mixed >= np.nanmin(means, axis=-2) - 1e-12).all()
    assert (mixed <= np.nanmax(means, axis=-2) + 1e-12).all()


@pytest.mark.parametrize("lanes", BATCHES)
def test_no_fusion_keeps_the_own_belief_whatever_the_others_are(lanes):
    beliefs = random_belief(np.random.default_rng(1), (*lanes, 3), 2)
    beliefs.mean[..., 1:, :] = np.nan
    kept = keep_own(beliefs, np.array([0.0, 0.5, 0.5]))
    np.testing.assert_array_equal(kept.mean, beliefs.mean[..., 0, :])
    np.testing.assert_array_equal(kept.cov, beliefs.cov[..., 0, :, :])
