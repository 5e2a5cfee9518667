"""Trimmed covariance intersection: what it promises whatever liars say, and what it costs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh

from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.fusion.hold import inverse_volume
from concord.filters.fusion.trimmed import trimmed_intersection
from concord.filters.gaussian import Gaussian

STATES = 3


def covariance(generator: np.random.Generator, scale: float) -> np.ndarray:
    """Of any shape, slanted ones included."""
    axes = np.linalg.qr(generator.standard_normal((STATES, STATES)))[0]
    return scale * axes @ np.diag(10 ** generator.uniform(-2, 1, STATES)) @ axes.T


def neighbourhood(
    seed: int, honest: int, liars: int, reach: float, claim: float
) -> tuple[Gaussian, np.ndarray]:
    """Beliefs, the own first and then honest ones, whose means liars miss by `reach` and who claim
    covariances of `claim`; and weights."""
    generator = np.random.default_rng(seed)
    mean = generator.standard_normal((1 + honest + liars, STATES))
    mean[1 + honest :] += reach * generator.standard_normal((liars, STATES))
    cov = np.array(
        [covariance(generator, 1.0) for _ in range(1 + honest)]
        + [covariance(generator, claim) for _ in range(liars)]
    )
    weights = generator.uniform(0.1, 1, len(mean))
    return Gaussian(mean, cov), weights / weights.sum()


SITUATIONS = {
    "seed": st.integers(0, 2**32 - 1),
    "liars": st.integers(1, 3),
    "more": st.integers(0, 3),
    "reach": st.sampled_from([0.0, 0.5, 3.0, 1e4]),
    "claim": st.sampled_from([1e-9, 1e-2, 1.0, 1e6]),
}


@given(**SITUATIONS)
def test_liars_move_it_no_farther_and_make_it_no_surer_than_honest_nodes_could(
    seed: int, liars: int, more: int, reach: float, claim: float
):
    honest = liars + more
    beliefs, weights = neighbourhood(seed, honest, liars, reach, claim)
    fused = trimmed_intersection(beliefs, weights, liars)
    own = beliefs.cov[0]
    surest = min(eigh(cov, own, eigvals_only=True)[0] for cov in beliefs.cov[: 1 + honest])
    assert eigh(fused.cov, own, eigvals_only=True)[0] >= surest * (1 - 1e-9)
    median = np.median(beliefs.mean, axis=0)
    off = beliefs.mean[: 1 + honest] - median
    radius2 = np.einsum("ji,ik,jk->j", off, np.linalg.inv(own), off).max()
    miss = fused.mean - median
    assert miss @ np.linalg.solve(fused.cov, miss) <= radius2 / surest * (1 + 1e-9)
    # The middle is itself among the honest.
    assert (median >= beliefs.mean[: 1 + honest].min(axis=0)).all()
    assert (median <= beliefs.mean[: 1 + honest].max(axis=0)).all()


@given(seed=st.integers(0, 2**32 - 1), honest=st.integers(0, 5))
def test_without_liars_to_fear_it_is_covariance_intersection_by_sharpness(seed: int, honest: int):
    beliefs, weights = neighbourhood(seed, honest, 0, 0.0, 1.0)
    worth = weights * inverse_volume(beliefs.cov)
    plain = covariance_intersection(beliefs, worth / worth.sum())
    fused = trimmed_intersection(beliefs, weights, 0)
    np.testing.assert_allclose(fused.mean, plain.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fused.cov, plain.cov, rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), liars=st.integers(1, 3))
def test_who_hears_too_few_keeps_its_own(seed: int, liars: int):
    beliefs, weights = neighbourhood(seed, liars - 1, liars, 3.0, 1e-3)
    fused = trimmed_intersection(beliefs, weights, liars)
    np.testing.assert_allclose(fused.mean, beliefs.mean[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fused.cov, beliefs.cov[0], rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
def test_equal_beliefs_stay_equal(seed: int):
    beliefs, weights = neighbourhood(seed, 4, 0, 0.0, 1.0)
    same = Gaussian(np.repeat(beliefs.mean[:1], 5, 0), np.repeat(beliefs.cov[:1], 5, 0))
    fused = trimmed_intersection(same, weights, 2)
    np.testing.assert_allclose(fused.mean, beliefs.mean[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fused.cov, beliefs.cov[0], rtol=1e-9)


def test_what_has_no_weight_says_nothing_and_counts_for_nobody():
    beliefs, weights = neighbourhood(5, 4, 1, 3.0, 1e-3)
    fused = trimmed_intersection(beliefs, weights, 1)
    silent = np.full(STATES, np.nan)
    mean = np.insert(beliefs.mean, 2, silent, axis=0)
    cov = np.insert(beliefs.cov, 2, np.full((STATES, STATES), np.nan), axis=0)
    padded = trimmed_intersection(Gaussian(mean, cov), np.insert(weights, 2, 0.0), 1)
    np.testing.assert_allclose(padded.mean, fused.mean, rtol=1e-12)
    np.testing.assert_allclose(padded.cov, fused.cov, rtol=1e-12)


def test_lanes_are_apart_and_one_that_fails_fails_alone():
    lanes = [neighbourhood(seed, 4, 1, 30.0, 1e-3) for seed in range(4)]
    mean = np.stack([one.mean for one, _ in lanes])
    cov = np.stack([one.cov for one, _ in lanes])
    weights = np.stack([one for _, one in lanes])
    cov[2, 0] = -np.eye(STATES)
    fused = trimmed_intersection(Gaussian(mean, cov), weights, 1)
    assert np.isnan(fused.mean[2]).all()
    for lane in (0, 1, 3):
        alone = trimmed_intersection(*lanes[lane], 1)
        np.testing.assert_allclose(fused.mean[lane], alone.mean, rtol=1e-10)
        np.testing.assert_allclose(fused.cov[lane], alone.cov, rtol=1e-10)


def test_weights_that_are_none_are_refused():
    beliefs, weights = neighbourhood(1, 2, 0, 0.0, 1.0)
    with pytest.raises(ValueError, match="sum to 1"):
        trimmed_intersection(beliefs, 2 * weights, 1)


@pytest.mark.parametrize("seed", range(20))
def test_rounding_does_not_decide_which_belief_is_dropped(seed: int):
    generator = np.random.default_rng(seed)
    mean = np.array([[3.0, -1.0, 0.5]]).repeat(4, axis=0)
    cov = np.stack([covariance(generator, 1.0) for _ in range(4)])
    weights = np.full(4, 0.25)
    alike = trimmed_intersection(Gaussian(mean, cov), weights, 1)
    rounded = mean + generator.normal(size=mean.shape) * 1e-14
    found = trimmed_intersection(Gaussian(rounded, cov), weights, 1)
    np.testing.assert_allclose(found.mean, alike.mean, rtol=1e-10)
    np.testing.assert_allclose(found.cov, alike.cov, rtol=1e-10)


@pytest.mark.parametrize("seed", range(20))
def test_rounding_does_not_decide_between_beliefs_on_both_sides_of_the_median(seed: int):
    """Along a line the median of four lies halfway between two, which are equally far from it."""
    generator = np.random.default_rng(seed)
    along = np.array([0.0, 0.1, -2.0, 2.1])
    mean = along[:, None] * np.array([1.0, -0.5, 0.3]) + np.array([3.0, -1.0, 0.5])
    cov = np.stack([covariance(generator, 1.0) for _ in range(4)])
    weights = np.full(4, 0.25)
    exact = trimmed_intersection(Gaussian(mean, cov), weights, 1)
    for _ in range(5):
        rounded = mean + generator.normal(size=mean.shape) * 1e-14
        found = trimmed_intersection(Gaussian(rounded, cov), weights, 1)
        np.testing.assert_allclose(found.mean, exact.mean, rtol=1e-10)
        np.testing.assert_allclose(found.cov, exact.cov, rtol=1e-10)
