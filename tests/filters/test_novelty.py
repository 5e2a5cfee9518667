import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.filters import ukf
from concord.filters.fusion.novelty import absorb, novelty
from concord.filters.gaussian import Gaussian, Information
from concord.filters.sigma_points import scaled_unscented
from tests.filters import kalman
from tests.filters.support import (
    BATCHES,
    RANGE_BEARING_NOISE_COV,
    TURN_START,
    random_belief,
    random_spd,
    range_bearing,
)

SEEDS = st.integers(0, 2**16)
LANES = st.sampled_from(BATCHES)


@given(lanes=LANES, n=st.integers(1, 4), m=st.integers(1, 3), seed=SEEDS)
def test_a_linear_sensor_adds_the_same_to_every_prior(lanes, n, m, seed):
    generator = np.random.default_rng(seed)
    H, R = generator.standard_normal((m, n)), random_spd(generator, (), m)
    value = generator.standard_normal((*lanes, m))
    expected_matrix = H.T @ np.linalg.inv(R) @ H
    expected_vector = value @ np.linalg.inv(R) @ H
    for _ in range(2):
        prior = random_belief(generator, lanes, n)
        added = novelty(prior, kalman.update(prior, value, H, R).belief)
        np.testing.assert_allclose(added.matrix - expected_matrix, 0, atol=1e-8)
        np.testing.assert_allclose(added.vector, expected_vector, rtol=1e-7, atol=1e-8)


def test_no_reading_adds_nothing_to_the_last_bit():
    prior = random_belief(np.random.default_rng(1), (3,), 4)
    nothing = np.full((3, 1), np.nan)
    after = ukf.update(prior, nothing, lambda x: x[..., :1], np.eye(1), scaled_unscented(4)).belief
    added = novelty(prior, after)
    assert not added.vector.any()
    assert not added.matrix.any()


def test_an_unscented_update_adds_no_negative_information():
    prior = Gaussian(np.stack([TURN_START.mean] * 2), np.stack([TURN_START.cov] * 2))
    value = range_bearing(prior.mean) + 0.1
    after = ukf.update(prior, value, range_bearing, RANGE_BEARING_NOISE_COV, scaled_unscented(5))
    added = novelty(prior, after.belief)
    least = np.linalg.eigvalsh(added.matrix)[:, 0]
    assert (least > -1e-9 * np.linalg.norm(added.matrix, axis=(1, 2))).all()


@given(lanes=LANES, count=st.integers(1, 4), n=st.integers(1, 3), seed=SEEDS)
def test_absorbing_is_the_kalman_update_by_all_that_was_heard(lanes, count, n, seed):
    generator = np.random.default_rng(seed)
    prior = random_belief(generator, lanes, n)
    H = generator.standard_normal((count, 1, n))
    R = generator.uniform(0.2, 2.0, count)
    values = generator.standard_normal((*lanes, count, 1))
    heard = generator.random((*lanes, count)) < 0.7
    parts = []
    for j in range(count):
        part = novelty(
            prior, kalman.update(prior, values[..., j, :], H[j], R[j] * np.eye(1)).belief
        )
        parts.append(part)
    vectors = np.stack([part.vector for part in parts], axis=-2)
    matrices = np.stack([part.matrix for part in parts], axis=-3)
    vectors[~heard, generator.integers(n)] = np.nan
    together = absorb(prior, Information(vectors, matrices))
    stacked = np.where(heard, values[..., 0], np.nan)
    expected = kalman.update(prior, stacked, H[:, 0], np.diag(R)).belief
    np.testing.assert_allclose(together.mean, expected.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(together.cov, expected.cov, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("spoil", ["prior", "novelty"])
def test_what_is_not_positive_definite_spoils_its_lane_alone(spoil):
    prior = random_belief(np.random.default_rng(2), (2,), 2)
    matrices = np.zeros((2, 1, 2, 2))
    if spoil == "prior":
        prior.cov[0] = -np.eye(2)
    else:
        matrices[0, 0] = -1e3 * np.eye(2)
    after = absorb(prior, Information(np.zeros((2, 1, 2)), matrices))
    assert np.isnan(after.mean[0]).all()
    np.testing.assert_allclose(after.mean[1], prior.mean[1])
    np.testing.assert_allclose(after.cov[1], prior.cov[1], rtol=1e-12)
