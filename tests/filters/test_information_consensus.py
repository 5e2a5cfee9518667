"""Consensus on prior and novelty (HCMCI) and on their weighted sum (ICF), by exact algebra."""

from functools import partial

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.fusion import hybrid_consensus, information_weighted
from concord.filters.fusion.novelty import novelty
from concord.filters.fusion.packed import average
from concord.filters.gaussian import Gaussian, to_information
from tests.filters import kalman
from tests.filters.support import random_belief

SEEDS = st.integers(0, 2**16)


def primitive_weights(generator: np.random.Generator, count: int) -> np.ndarray:
    """Row-stochastic with positive diagonal, many entries zero."""
    weights = generator.random((count, count)) * (generator.random((count, count)) < 0.5)
    weights += np.eye(count) * generator.uniform(0.1, 1.0, count)
    return weights / weights.sum(axis=1, keepdims=True)


def posteriors(generator, priors: Gaussian) -> Gaussian:
    """Each of priors (..., N, n) after a scalar reading of its own."""
    H = generator.standard_normal((*priors.mean.shape[:-1], 1, priors.mean.shape[-1]))
    value = generator.standard_normal((*priors.mean.shape[:-1], 1))
    return kalman.update(priors, value, H, 0.5 * np.eye(1)).belief


def after_rounds(known: np.ndarray, weights: np.ndarray, rounds: int) -> np.ndarray:
    """Return the values of the nodes (..., N, m) after so many full rounds."""
    for _ in range(rounds):
        count = len(weights)
        everyone = np.broadcast_to(
            known[..., None, :, :], (*known.shape[:-2], count, count, known.shape[-1])
        )
        known = average(everyone, weights)
    return known


@given(nodes=st.integers(1, 5), n=st.integers(1, 3), rounds=st.integers(0, 4), seed=SEEDS)
def test_hybrid_consensus_is_its_formula(nodes, n, rounds, seed):
    generator = np.random.default_rng(seed)
    weights = primitive_weights(generator, nodes)
    priors = random_belief(generator, (nodes,), n)
    after = posteriors(generator, priors)
    known = hybrid_consensus.begin(priors, after, np.eye(nodes))
    belief = hybrid_consensus.from_information(after_rounds(known, weights, rounds), n)
    power = np.linalg.matrix_power(weights, rounds)
    old, added = to_information(priors), novelty(priors, after)
    for i, row in enumerate(power):
        g = 1 / max(row)
        matrix = sum(a * (old.matrix[j] + g * added.matrix[j]) for j, a in enumerate(row))
        vector = sum(a * (old.vector[j] + g * added.vector[j]) for j, a in enumerate(row))
        np.testing.assert_allclose(np.linalg.inv(belief.cov[i]), matrix, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(matrix @ belief.mean[i], vector, rtol=1e-7, atol=1e-7)


def test_a_failed_lane_fails_alone():
    generator = np.random.default_rng(3)
    priors = random_belief(generator, (2, 3), 2)
    after = posteriors(generator, priors)
    priors.cov[0, 1] = -np.eye(2)
    uniform = np.full((3, 3), 1 / 3)
    for known, from_information in (
        (
            hybrid_consensus.begin(priors, after, np.eye(3)),
            partial(hybrid_consensus.from_information, states=2),
        ),
        (
            information_weighted.begin(priors, after, 3),
            partial(information_weighted.from_information, nodes=3),
        ),
    ):
        belief = from_information(after_rounds(known, uniform, 0))
        failed = np.isnan(belief.mean).all(axis=-1)
        assert failed.tolist() == [[False, True, False], [False] * 3]


# --- what a node takes from a peer ---------------------------------------------------------------


def test_shares_of_no_sound_node_are_recognised():
    generator = np.random.default_rng(4)
    priors = random_belief(generator, (5,), 2)
    known = hybrid_consensus.begin(priors, posteriors(generator, priors), np.eye(5))
    known[1, 2] = -1.0  # prior information that is not positive definite
    known[2, 7] = -1e3  # a reading that took information away
    known[3, -2:] = 1.5, -0.5  # a weight below 0
    known[4, -1] = 0.5  # weights that sum to more than 1
    assert hybrid_consensus.sound(known, 2).tolist() == [True, False, False, False, False]
    pair = information_weighted.begin(priors, priors, 5)
    pair[1, 2] = -1.0
    pair[2] = np.nan
    assert information_weighted.sound(pair).tolist() == [True, False, False, True, True]


@given(nodes=st.integers(1, 4), n=st.integers(1, 3), seed=SEEDS)
def test_averages_of_sound_shares_always_come_to_a_belief(nodes, n, seed):
    """Also those of liars: random numbers that pass the test."""
    generator = np.random.default_rng(seed)
    known = hybrid_consensus.begin(
        random_belief(generator, (nodes,), n), random_belief(generator, (nodes,), n), np.eye(nodes)
    )
    sound = known[hybrid_consensus.sound(known, n)]
    if len(sound) == 0:
        return
    mixed = average(sound, generator.dirichlet(np.ones(len(sound))))
    assert np.isfinite(hybrid_consensus.from_information(mixed, n).cov).all()
