import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.filters.fusion.averaging import (
    INFORMATION,
    MOMENTS,
    Directly,
    covariance_intersection,
    weighted_average,
)
from concord.filters.gaussian import Gaussian
from tests.filters.support import BATCHES, random_belief

RULES = pytest.mark.parametrize("fuse", [weighted_average, covariance_intersection])
SEEDS = st.integers(0, 2**16)
LANES = st.sampled_from(BATCHES)


def random_weights(generator, lanes, count):
    return generator.dirichlet(np.ones(count), lanes)


@settings(deadline=None)
@given(lanes=LANES, count=st.integers(1, 5), n=st.integers(1, 4), seed=SEEDS)
def test_both_rules_are_their_formulas(lanes, count, n, seed):
    generator = np.random.default_rng(seed)
    beliefs = random_belief(generator, (*lanes, count), n)
    weights = random_weights(generator, lanes, count)
    average = weighted_average(beliefs, weights)
    intersection = covariance_intersection(beliefs, weights)
    for lane in np.ndindex(lanes):
        terms = list(zip(weights[lane], beliefs.mean[lane], beliefs.cov[lane], strict=True))
        np.testing.assert_allclose(average.mean[lane], sum(w * x for w, x, _ in terms), atol=1e-12)
        np.testing.assert_allclose(average.cov[lane], sum(w * P for w, _, P in terms), atol=1e-12)
        matrix = sum(w * np.linalg.inv(P) for w, _, P in terms)
        vector = sum(w * np.linalg.solve(P, x) for w, x, P in terms)
        cov = np.linalg.inv(matrix)
        np.testing.assert_allclose(intersection.cov[lane], cov, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(intersection.mean[lane], cov @ vector, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("rule", [MOMENTS, INFORMATION])
@pytest.mark.parametrize("lanes", BATCHES)
def test_one_factorisation_gives_the_numbers_and_the_determinant(rule, lanes):
    belief = random_belief(np.random.default_rng(5), (*lanes, 3), 4)
    belief.cov[..., 1, :, :] = np.diag([1.0, -1.0, 1.0, 1.0])
    origin = belief.mean[..., :1, :]
    numbers, inverse_volume = rule.to_numbers(belief, origin)
    for sound in (0, 2):
        back = rule.from_numbers(numbers[..., sound, :], origin[..., 0, :])
        np.testing.assert_allclose(back.mean, belief.mean[..., sound, :], rtol=1e-9)
        np.testing.assert_allclose(back.cov, belief.cov[..., sound, :, :], rtol=1e-9, atol=1e-9)
    determinants = np.linalg.det(belief.cov[..., ::2, :, :])
    np.testing.assert_allclose(inverse_volume[..., ::2], determinants**-0.25, rtol=1e-10)
    np.testing.assert_allclose(
        rule.inverse_volume(numbers)[..., ::2], inverse_volume[..., ::2], rtol=1e-10
    )
    assert np.isnan(inverse_volume[..., 1]).all()


@pytest.mark.parametrize("by_inverse_volume", [False, True])
@pytest.mark.parametrize(
    ("rule", "direct"), [(MOMENTS, weighted_average), (INFORMATION, covariance_intersection)]
)
@settings(deadline=None, max_examples=30)
@given(others=st.integers(1, 11), n=st.integers(1, 5), seed=SEEDS)
def test_a_node_fuses_as_the_formula_says(rule, direct, by_inverse_volume, others, n, seed):
    generator = np.random.default_rng(seed)
    own, held = random_belief(generator, (), n), random_belief(generator, (others,), n)
    weights = random_weights(generator, (), 1 + others)
    weights[generator.integers(1 + others)] = 0.0
    weights /= weights.sum()
    means, covs = np.vstack([own.mean, held.mean]), np.concatenate([own.cov[None], held.cov])
    inverse_volume = np.linalg.det(covs) ** (-1 / n)
    expected = (
        weights * inverse_volume / (weights @ inverse_volume) if by_inverse_volume else weights
    )
    for ways in (rule.fuse, Directly(direct).fuse):
        belief, used, sharp = ways(own, held, weights, by_inverse_volume)
        np.testing.assert_allclose(sharp, inverse_volume, rtol=1e-10)
        np.testing.assert_allclose(used, expected, rtol=1e-10)
        there = direct(Gaussian(means, covs), expected)
        np.testing.assert_allclose(belief.mean, there.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(belief.cov, there.cov, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(belief.cov, belief.cov.mT)


@pytest.mark.parametrize("rule", [MOMENTS, INFORMATION])
def test_what_weighs_nothing_may_be_anything_and_what_is_no_belief_is_told(rule):
    generator = np.random.default_rng(3)
    own, held = random_belief(generator, (), 3), random_belief(generator, (9,), 3)
    weights = np.full(10, 1 / 9)
    weights[4] = 0.0
    for by_inverse_volume in (False, True):
        sound = rule.fuse(own, held, weights, by_inverse_volume)
        held.mean[3], held.cov[3] = np.nan, np.nan
        unheard = rule.fuse(own, held, weights, by_inverse_volume)
        assert np.isnan(unheard.inverse_volume).tolist() == [place == 4 for place in range(10)]
        np.testing.assert_array_equal(unheard.weights, sound.weights)
        np.testing.assert_array_equal(unheard.belief.cov, sound.belief.cov)
        np.testing.assert_array_equal(unheard.belief.mean, sound.belief.mean)
        held.mean[3], held.cov[3] = own
    held.cov[6] = np.diag([1.0, -1.0, 1.0])
    failed = rule.fuse(own, held, weights, True)
    assert np.isnan(failed.inverse_volume).tolist() == [place == 7 for place in range(10)]
    assert np.isnan(failed.belief.mean).all() and np.isnan(failed.belief.cov).all()


@RULES
def test_a_unit_weight_returns_its_belief_whatever_the_others_are(fuse):
    generator = np.random.default_rng(2)
    mean, cov = random_belief(generator, (3,), 3)
    for j in range(3):
        beliefs = Gaussian(np.full((3, 3), np.nan), np.full((3, 3, 3), np.nan))
        beliefs.mean[j], beliefs.cov[j] = mean[j], cov[j]
        fused = fuse(beliefs, np.eye(3)[j])
        np.testing.assert_allclose(fused.mean, mean[j], rtol=1e-12)
        np.testing.assert_allclose(fused.cov, cov[j], rtol=1e-11)


@RULES
def test_an_entry_of_no_weight_does_not_matter(fuse):
    generator = np.random.default_rng(3)
    beliefs = random_belief(generator, (2, 3), 2)
    weights = np.array([[0.5, 0.0, 0.5], [0.2, 0.3, 0.5]])
    expected = fuse(beliefs, weights)
    beliefs.mean[0, 1], beliefs.cov[0, 1] = np.nan, -np.inf
    fused = fuse(beliefs, weights)
    np.testing.assert_array_equal(fused.mean, expected.mean)
    np.testing.assert_array_equal(fused.cov, expected.cov)


@RULES
def test_a_failed_entry_with_weight_spoils_its_lane_alone(fuse):
    beliefs = random_belief(np.random.default_rng(4), (2, 3), 2)
    beliefs.mean[0, 1] = beliefs.cov[0, 1] = np.nan
    fused = fuse(beliefs, np.full(3, 1 / 3))
    assert np.isnan(fused.mean[0]).all()
    assert np.isfinite(fused.mean[1]).all()


def test_averaging_takes_singular_covariances():
    cov = np.stack([np.diag([1.0, 0.0]), np.diag([0.0, 0.0])])
    fused = weighted_average(Gaussian(np.eye(2), cov), np.array([0.5, 0.5]))
    np.testing.assert_array_equal(fused.cov, np.diag([0.5, 0.0]))


@RULES
@pytest.mark.parametrize("weights", [[0.6, 0.6], [1.5, -0.5], [0.0, 0.0]])
def test_weights_that_do_not_average_are_refused(fuse, weights):
    beliefs = random_belief(np.random.default_rng(5), (2,), 2)
    with pytest.raises(ValueError, match="sum to 1"):
        fuse(beliefs, np.array(weights))
