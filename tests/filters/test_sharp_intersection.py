"""Covariance intersection with sharper weights: bounds of its determinant, units, consistency."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.filters.columns import MANY_LANES
from concord.filters.fusion.averaging import Fused, covariance_intersection
from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.fusion.sharp_intersection import SharpIntersection
from concord.filters.gaussian import Gaussian

SEEDS = st.integers(0, 2**32 - 1)


def sharp_intersection(beliefs: Gaussian, weights: np.ndarray) -> Gaussian:
    """The rule of beliefs (..., J, n), as a node has it that is the first of them."""
    own = Gaussian(beliefs.mean[..., 0, :], beliefs.cov[..., 0, :, :])
    others = Gaussian(beliefs.mean[..., 1:, :], beliefs.cov[..., 1:, :, :])
    return SharpIntersection().fuse(own, others, weights, False).belief


def neighbourhood(rng: np.random.Generator, count: int, states: int) -> tuple[Gaussian, np.ndarray]:
    """Beliefs of unlike size and direction (5, J, n), and weights that sum to 1."""
    factors = rng.normal(size=(5, count, states, states)) * 10 ** rng.uniform(
        -1, 1, (5, count, 1, states)
    )
    covs = factors @ factors.mT + 1e-3 * np.eye(states)
    weights = rng.dirichlet(np.ones(count), size=5)
    return Gaussian(rng.normal(size=(5, count, states)), covs), weights


@given(SEEDS, st.integers(1, 6), st.integers(1, 5))
def test_the_weights_are_five_steps_of_titterington(seed, count, states):
    beliefs, weights = neighbourhood(np.random.default_rng(seed), count, states)
    own = Gaussian(beliefs.mean[:, 0], beliefs.cov[:, 0])
    others = Gaussian(beliefs.mean[:, 1:], beliefs.cov[:, 1:])
    found = SharpIntersection().fuse(own, others, weights, False).weights
    for lane, w in enumerate(weights):
        information = np.linalg.inv(beliefs.cov[lane])
        for _ in range(5):
            fused = np.linalg.inv(np.tensordot(w, information, 1))
            w = w * np.trace(fused @ information, axis1=-2, axis2=-1) / states
        np.testing.assert_allclose(found[lane], w, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("by_inverse_volume", [False, True])
def test_many_lanes_give_what_a_node_gives(by_inverse_volume):
    """Lanes on two axes, in two orders of memory, a share of weight zero among them."""
    rng = np.random.default_rng(3)
    parts = [neighbourhood(rng, 4, 5) for _ in range(MANY_LANES)]
    means, covs = (np.stack([part[0][field] for part in parts]) for field in range(2))
    weights = np.stack([part[1] for part in parts])
    weights[1, 2] = 0.5, 0.0, 0.5, 0.0
    covs[1, 2, 1] = np.nan

    def fused(means: np.ndarray, covs: np.ndarray, weights: np.ndarray) -> Fused:
        own = Gaussian(means[..., 0, :], covs[..., 0, :, :])
        others = Gaussian(means[..., 1:, :], covs[..., 1:, :, :])
        return SharpIntersection().fuse(own, others, weights, by_inverse_volume)

    many = fused(means, covs, weights)
    turned = fused(*(np.asfortranarray(array) for array in (means, covs, weights)))
    np.testing.assert_array_equal(turned.belief.cov, many.belief.cov)
    np.testing.assert_array_equal(turned.belief.mean, many.belief.mean)
    for lane in np.ndindex(weights.shape[:-1]):
        one = fused(means[lane], covs[lane], weights[lane])
        np.testing.assert_allclose(many.weights[lane], one.weights, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(many.belief.mean[lane], one.belief.mean, rtol=1e-8, atol=1e-9)
        scale = np.abs(one.belief.cov).max()
        np.testing.assert_allclose(many.belief.cov[lane], one.belief.cov, atol=1e-9 * scale)
        np.testing.assert_allclose(many.inverse_volume[lane], one.inverse_volume, rtol=1e-10)


@given(SEEDS, st.integers(1, 6), st.integers(1, 5))
@settings(max_examples=60)
def test_the_determinant_is_at_most_that_of_covariance_intersection(seed, count, states):
    beliefs, weights = neighbourhood(np.random.default_rng(seed), count, states)
    sharp = np.linalg.slogdet(sharp_intersection(beliefs, weights).cov)[1]
    plain = np.linalg.slogdet(covariance_intersection(beliefs, weights).cov)[1]
    assert (sharp <= plain + 1e-9).all()


@given(SEEDS, st.integers(1, 4))
def test_the_determinant_of_two_is_at_least_the_optimum(seed, states):
    beliefs, weights = neighbourhood(np.random.default_rng(seed), 2, states)
    own, other = (Gaussian(beliefs.mean[:, j], beliefs.cov[:, j]) for j in range(2))
    optimum = np.linalg.slogdet(determinant_intersection(own, other).cov)[1]
    sharp = np.linalg.slogdet(sharp_intersection(beliefs, weights).cov)[1]
    assert (sharp >= optimum - 1e-5).all()


@given(SEEDS, st.integers(1, 5))
def test_equal_covariances_keep_the_weights(seed, count):
    rng = np.random.default_rng(seed)
    beliefs, weights = neighbourhood(rng, count, 3)
    alike = beliefs._replace(cov=np.repeat(beliefs.cov[:, :1], count, axis=1))
    sharp, plain = sharp_intersection(alike, weights), covariance_intersection(alike, weights)
    np.testing.assert_allclose(sharp.mean, plain.mean, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(sharp.cov, plain.cov, rtol=1e-7)


@given(SEEDS)
def test_units_and_axes_of_the_state_have_no_effect(seed):
    rng = np.random.default_rng(seed)
    beliefs, weights = neighbourhood(rng, 4, 3)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] * 10 ** rng.uniform(-1, 1, 3)
    moved = Gaussian(beliefs.mean @ axes.T, axes @ beliefs.cov @ axes.T)
    plain, fused = sharp_intersection(beliefs, weights), sharp_intersection(moved, weights)
    back = np.linalg.inv(axes)
    whitener = np.linalg.inv(np.linalg.cholesky(plain.cov))
    cov = whitener @ back @ fused.cov @ back.T @ whitener.mT
    np.testing.assert_allclose(cov, np.broadcast_to(np.eye(3), cov.shape), atol=1e-6)
    apart = whitener @ (fused.mean @ back.T - plain.mean)[..., None]
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)


@given(SEEDS, st.integers(2, 4), st.integers(1, 3))
def test_the_covariance_bounds_the_error_under_any_correlation(seed, count, states):
    """Gains by unit means; errors whose joint covariance has the beliefs' blocks."""
    rng = np.random.default_rng(seed)
    beliefs, weights = neighbourhood(rng, count, states)
    one = Gaussian(beliefs.mean[0], beliefs.cov[0])
    factors = np.linalg.cholesky(one.cov)
    sources = rng.normal(size=(count, states, 2 * states))
    mixed = np.stack([np.linalg.qr(some.T)[0].T for some in sources])
    joint = factors @ mixed  # rows of orthonormal mixtures: each block is the belief's covariance
    gains = np.zeros((states, count, states))
    for j, axis in np.ndindex(count, states):
        unit = np.zeros((count, states))
        unit[j, axis] = 1.0
        gains[:, j, axis] = sharp_intersection(one._replace(mean=unit), weights[0]).mean
    np.testing.assert_allclose(gains.sum(axis=1), np.eye(states), atol=1e-6)
    error = np.einsum("ajb,jbc->ac", gains, joint)
    claimed = sharp_intersection(one, weights[0]).cov
    slack = np.linalg.eigvalsh(claimed - error @ error.T)
    assert slack.min() > -1e-7 * np.linalg.eigvalsh(claimed).max()


def test_a_belief_of_weight_zero_may_be_anything():
    beliefs, _ = neighbourhood(np.random.default_rng(1), 3, 2)
    weights = np.array([0.5, 0.5, 0.0])
    spoilt = Gaussian(beliefs.mean.copy(), beliefs.cov.copy())
    spoilt.mean[:, 2], spoilt.cov[:, 2] = np.nan, np.nan
    fused = sharp_intersection(spoilt, weights)
    pair = sharp_intersection(Gaussian(beliefs.mean[:, :2], beliefs.cov[:, :2]), weights[:2])
    np.testing.assert_array_equal(fused.mean, pair.mean)
    np.testing.assert_array_equal(fused.cov, pair.cov)
