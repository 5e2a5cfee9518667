"""Noise estimation: the fading average, what it converges to, and what it may never do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.vehicle.adaptive import sage_husa
from concord.features.vehicle.adaptive.sage_husa import Bounds
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from tests.filters.support import random_spd

RULE = scaled_unscented(2)


@pytest.mark.parametrize("forgetting", [0.9, 0.98])
def test_it_is_an_average_with_weights_that_fade_geometrically(forgetting):
    generator = np.random.default_rng(1)
    samples = generator.uniform(0.5, 2.0, 30)
    noise = sage_husa.begin(np.array([1.7]))
    for sample in samples:
        noise = sage_husa.adapt(
            noise, np.array([np.sqrt(sample)]), np.zeros(1), forgetting=forgetting
        )
    everything = np.concatenate(([1.7], samples))
    weights = forgetting ** np.arange(30, -1, -1.0)
    np.testing.assert_allclose(noise.variances[0], weights @ everything / weights.sum(), rtol=1e-12)


@given(
    residual=st.lists(st.floats(-1e8, 1e8), min_size=2, max_size=2),
    spread=st.floats(0, 1e8),
    start=st.floats(1e-8, 1e4),
)
def test_a_variance_stays_within_its_bounds(residual, spread, start):
    noise = sage_husa.begin(np.full(2, start))
    for _ in range(3):
        noise = sage_husa.adapt(
            noise, np.array(residual), np.full(2, spread), bounds=Bounds(1e-8, 1e4)
        )
    assert ((noise.variances >= 1e-8) & (noise.variances <= 1e4)).all()


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_what_is_learnt_does_not_depend_on_the_unit(unit: float):
    """Readings of 1e-5 rad were taken for ten times as noisy, and those of 1e3 m cut to 100 m."""
    generator = np.random.default_rng(4)
    usual, other = sage_husa.begin(np.array([1.0])), sage_husa.begin(np.array([unit**2]))
    for residual in 2 * generator.standard_normal((50, 1)):
        usual = sage_husa.adapt(usual, residual, np.full(1, 0.1))
        other = sage_husa.adapt(other, unit * residual, np.full(1, 0.1 * unit**2))
    np.testing.assert_allclose(other.variances, unit**2 * usual.variances, rtol=1e-12)


def test_bounds_may_differ_by_channel():
    bounds = Bounds(low=np.array([1.0, 1e-8]))
    noise = sage_husa.begin(np.array([1.0, 1.0]))
    for _ in range(300):
        noise = sage_husa.adapt(noise, np.zeros(2), np.zeros(2), bounds=bounds)
    assert noise.variances[0] == 1.0
    assert noise.variances[1] < 0.01


def test_an_outlier_counts_as_far_as_its_limit():
    noise = sage_husa.begin(np.array([1.0, 1.0]))
    limited = sage_husa.adapt(noise, np.array([100.0, 2.0]), np.zeros(2), outlier_limit=9.0)
    as_if = sage_husa.adapt(noise, np.array([3.0, 2.0]), np.zeros(2))
    np.testing.assert_array_equal(limited.variances, as_if.variances)


def test_what_was_not_taken_changes_nothing():
    noise = sage_husa.begin(np.array([[1.0, 2.0], [3.0, 4.0]]))
    after = sage_husa.adapt(noise, np.array([[np.nan, 1.0], [np.nan, np.nan]]), np.zeros((2, 2)))
    assert after.variances[0, 0] == 1.0
    np.testing.assert_array_equal(after.variances[1], [3.0, 4.0])
    np.testing.assert_array_equal(after.taken, [[0, 1], [0, 0]])


def test_the_residual_is_that_of_the_posterior():
    generator = np.random.default_rng(3)
    H = generator.standard_normal((3, 2))
    posterior = Gaussian(generator.standard_normal((4, 2)), random_spd(generator, (4,), 2))
    z = generator.standard_normal((4, 3))
    z[0, 1] = np.nan
    left, spread = sage_husa.unexplained(posterior, z, lambda x: x @ H.T, RULE)
    expected = z - posterior.mean @ H.T
    np.testing.assert_allclose(left, expected, rtol=1e-12, atol=1e-12)
    for lane in range(4):
        np.testing.assert_allclose(spread[lane], np.diag(H @ posterior.cov[lane] @ H.T))


def test_refusals_say_what_to_do():
    with pytest.raises(ValueError, match="data-sheet"):
        sage_husa.begin(np.array([1.0, 0.0]))
    with pytest.raises(ValueError, match=r"\.95 to \.99"):
        sage_husa.adapt(sage_husa.begin(np.ones(1)), np.ones(1), np.ones(1), forgetting=1.0)
