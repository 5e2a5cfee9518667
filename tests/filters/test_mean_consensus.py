"""Kalman consensus pulls no farther than its rate; without fusion a node keeps its belief."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters.fusion import kalman_consensus
from concord.filters.fusion.hold import keep_own
from concord.filters.gaussian import Gaussian
from tests.filters.support import BATCHES, random_belief, random_spd

SEEDS = st.integers(0, 2**16)


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


@pytest.mark.parametrize("lanes", BATCHES)
def test_no_fusion_keeps_the_own_belief_whatever_the_others_are(lanes):
    beliefs = random_belief(np.random.default_rng(1), (*lanes, 3), 2)
    beliefs.mean[..., 1:, :] = np.nan
    kept = keep_own(beliefs, np.array([0.0, 0.5, 0.5]))
    np.testing.assert_array_equal(kept.mean, beliefs.mean[..., 0, :])
    np.testing.assert_array_equal(kept.cov, beliefs.cov[..., 0, :, :])


def test_who_was_not_heard_does_not_pull():
    means = np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 2.0]])
    moved = kalman_consensus.average(means, 0.25)
    np.testing.assert_array_equal(moved, kalman_consensus.average(means[[0, 2]], 0.25))
    np.testing.assert_array_equal(moved, [1.5, 2.0])
