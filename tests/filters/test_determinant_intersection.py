"""Covariance intersection by determinant, against a search for the weight and against theory."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from concord.filters.fusion.determinant_intersection import determinant_intersection
from concord.filters.gaussian import Gaussian

SEEDS = st.integers(0, 2**32 - 1)


def belief(generator: np.random.Generator, n: int) -> Gaussian:
    root = generator.standard_normal((n, n + 1)) * generator.lognormal(0, 1, (n, 1))
    return Gaussian(generator.standard_normal(n), root @ root.T + 0.01 * np.eye(n))


def logdet(own: Gaussian, other: Gaussian, weight: float) -> float:
    fused = weight * np.linalg.inv(own.cov) + (1 - weight) * np.linalg.inv(other.cov)
    return np.linalg.slogdet(fused)[1]


@given(SEEDS, st.integers(1, 5))
@settings(max_examples=100)
def test_no_weight_leaves_a_smaller_determinant(seed: int, n: int):
    generator = np.random.default_rng(seed)
    own, other = belief(generator, n), belief(generator, n)
    best = minimize_scalar(
        lambda w: -logdet(own, other, w), bounds=(0, 1), method="bounded", options={"xatol": 1e-10}
    )
    found = -np.linalg.slogdet(determinant_intersection(own, other).cov)[1]
    ends = max(logdet(own, other, 0.0), logdet(own, other, 1.0))
    assert found == pytest.approx(max(-best.fun, ends), abs=2e-6)  # pyright: ignore[reportAttributeAccessIssue]


@given(SEEDS, st.integers(1, 5))
@settings(max_examples=100)
def test_the_fused_covariance_bounds_the_error_whatever_the_correlation(seed: int, n: int):
    """Any joint covariance of both errors whose blocks are the two covariances."""
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((2 * n, 2 * n)) * generator.lognormal(0, 1, (2 * n, 1))
    joint = root @ root.T + 0.01 * np.eye(2 * n)
    own, other = (Gaussian(np.zeros(n), joint[part, part]) for part in (np.s_[:n], np.s_[n:]))
    fused = determinant_intersection(own, other)
    # The rule is affine in the means: unit means give its gains.
    gains = [
        np.stack(
            [
                determinant_intersection(
                    own._replace(mean=unit * first), other._replace(mean=unit * (1 - first))
                ).mean
                for unit in np.eye(n)
            ],
            axis=-1,
        )
        for first in (1.0, 0.0)
    ]
    gain = np.concatenate(gains, axis=-1)
    margin = np.linalg.eigvalsh(fused.cov - gain @ joint @ gain.T)
    assert margin.min() > -1e-9 * np.trace(fused.cov)


@given(SEEDS, st.integers(1, 5), st.floats(1.0, 50.0))
def test_what_adds_nothing_changes_no_bit(seed: int, n: int, factor: float):
    generator = np.random.default_rng(seed)
    own = belief(generator, n)
    wider = Gaussian(generator.standard_normal(n), factor * own.cov)
    kept = determinant_intersection(own, wider)
    assert (kept.mean.tobytes(), kept.cov.tobytes()) == (own.mean.tobytes(), own.cov.tobytes())
    if factor > 1.001:
        taken = determinant_intersection(wider, own)
        assert taken.mean.tobytes() == own.mean.tobytes()


def test_complementary_beliefs_share_the_weight():
    own = Gaussian(np.zeros(2), np.diag([1.0, 9.0]))
    other = Gaussian(np.ones(2), np.diag([9.0, 1.0]))
    fused = determinant_intersection(own, other)
    np.testing.assert_allclose(fused.cov, np.diag([1.8, 1.8]), rtol=1e-12)
    np.testing.assert_allclose(fused.mean, [0.1, 0.9], rtol=1e-12)


def test_a_lane_that_is_no_covariance_is_nan_alone():
    generator = np.random.default_rng(0)
    pairs = [(belief(generator, 3), belief(generator, 3)) for _ in range(3)]
    own, other = (
        Gaussian(np.stack([b.mean for b in side]), np.stack([b.cov for b in side]))
        for side in zip(*pairs, strict=True)
    )
    other.cov[1] = -np.eye(3)
    fused = determinant_intersection(own, other)
    assert np.isnan(fused.mean[1]).all() and np.isnan(fused.cov[1]).all()
    for lane in (0, 2):
        alone = determinant_intersection(*pairs[lane])
        np.testing.assert_allclose(fused.mean[lane], alone.mean, rtol=1e-12)
        np.testing.assert_allclose(fused.cov[lane], alone.cov, rtol=1e-12)
