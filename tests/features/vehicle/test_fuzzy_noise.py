"""Covariance matching with a fuzzy rule base."""

import numpy as np
import pytest

from concord.features.vehicle.adaptive import fuzzy_noise
from concord.features.vehicle.adaptive.fuzzy_noise import GROW, SHRINK, WINDOW, factor
from concord.features.vehicle.adaptive.sage_husa import Bounds

UNIT = np.ones(1)
LIMITS = Bounds(1e-8, 1e4)


def feed(noise, innovations, expected=UNIT):
    for innovation in innovations:
        noise = fuzzy_noise.adapt(noise, np.array([innovation]), expected, LIMITS)
    return noise


def test_the_rules_at_their_corners():
    np.testing.assert_allclose(
        factor(np.array([0.0, 0.5, 0.75, 1.0, 1.5, 2.0, 50.0])),
        [SHRINK, SHRINK, (SHRINK + 1) / 2, 1.0, (GROW + 1) / 2, GROW, GROW],
    )


def test_a_window_must_fill_before_anything_changes():
    noise = feed(fuzzy_noise.begin(np.ones(1)), [10.0] * (WINDOW - 1))
    assert noise.variances[0] == 1.0
    assert feed(noise, [10.0]).variances[0] == pytest.approx(GROW)


@pytest.mark.parametrize(("size", "expected"), [(10.0, GROW), (0.1, SHRINK), (1.0, 1.0)])
def test_it_grows_shrinks_or_stays(size, expected):
    noise = feed(fuzzy_noise.begin(np.ones(1)), [size, -size] * (WINDOW // 2))
    assert noise.variances[0] == pytest.approx(expected)


def test_only_the_last_innovations_count():
    noise = feed(fuzzy_noise.begin(np.ones(1)), [100.0] * 5 + [1.0] * WINDOW)
    assert noise.variances[0] == feed(noise, [1.0]).variances[0]


def test_bounds_hold_and_missing_readings_change_nothing():
    noise = feed(fuzzy_noise.begin(np.full(1, 9e3)), [1e9] * 100)
    assert noise.variances[0] == 1e4
    again = feed(noise, [np.nan] * 50)
    np.testing.assert_array_equal(again.variances, noise.variances)
    np.testing.assert_array_equal(again.squared, noise.squared)


@pytest.mark.parametrize("start", [0.01, 100.0])
def test_it_settles_where_innovations_are_what_is_expected(start):
    """For a filter without gain the expected variance is R itself: it must find the true 1."""
    generator = np.random.default_rng(1)
    noise = fuzzy_noise.begin(np.full((100, 1), start))
    for _ in range(400):
        innovation = generator.standard_normal((100, 1))
        noise = fuzzy_noise.adapt(noise, innovation, noise.variances)
    assert abs(np.log(noise.variances).mean()) < 0.15
