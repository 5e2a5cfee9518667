"""Intervals over runs hold what they say, and pairs are worth more than strangers."""

import numpy as np
import pytest

from experiments.monte_carlo.intervals import (
    METHODS,
    mean_bootstrap,
    mean_t,
    ratio_bootstrap,
    ratio_t,
)


def covered(method: str, runs: int, trials: int) -> tuple[float, float]:
    """Share of the trials in which the interval holds the true mean, and the true ratio."""
    generator = np.random.default_rng(7)
    mean_of, ratio_of = METHODS[method]
    held = np.zeros(2)
    for _ in range(trials):
        common = generator.gamma(8, 1 / 8, runs)
        a, b = (common * generator.gamma(20, mean / 20, runs) for mean in (4, 1))
        one, two = mean_of(a), ratio_of(a, b)
        held += [one.low <= 4 <= one.high, two.low <= 2 <= two.high]
    return float(held[0] / trials), float(held[1] / trials)


def test_an_interval_holds_the_truth_as_often_as_it_says():
    # Four standard deviations of a binomial share of 0.95 in 1000 trials are 0.028.
    for share in covered("t", runs=20, trials=1000):
        assert 0.95 - 0.04 <= share <= 0.95 + 0.028


@pytest.mark.slow
def test_so_does_the_bootstrap():
    for share in covered("bootstrap", runs=30, trials=200):
        assert 0.95 - 0.09 <= share <= 1.0


def test_pairs_that_share_their_noise_are_compared_more_exactly():
    generator = np.random.default_rng(1)
    common = generator.gamma(2, 1, 40)
    a, b = 1.1 * common * generator.gamma(200, 1 / 200, 40), common
    paired = ratio_t(a, b)
    strangers = ratio_t(a, generator.permutation(b))
    assert paired.high - paired.low < 0.2 * (strangers.high - strangers.low)
    assert paired.low <= np.sqrt(1.1) <= paired.high


def test_the_ratio_is_that_of_root_means_and_not_the_mean_of_ratios():
    assert ratio_t(np.array([4.0, 16.0]), np.array([1.0, 1.0])).value == pytest.approx(np.sqrt(10))


@pytest.mark.parametrize("method", METHODS)
def test_one_run_has_no_interval_and_none_has_nothing(method: str):
    mean, ratio = METHODS[method]
    one = mean(np.array([3.0]))
    assert one.value == 3 and np.isnan(one.low) and np.isnan(one.high)
    assert np.isnan(ratio(np.array([]), np.array([])).value)
    assert mean(np.array([1.0, np.nan, 3.0])).value == 2


def test_what_is_equal_in_every_run_is_certain():
    same = np.full(5, 2.0)
    assert mean_bootstrap(same) == mean_t(same) == (2, 2, 2)
    assert ratio_bootstrap(same, same) == (1, 1, 1)
