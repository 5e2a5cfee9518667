"""Intervals over runs hold what they say, and pairs are worth more than strangers."""

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis.extra.numpy import arrays

from concord.results.figures.intervals import (
    METHODS,
    Interval,
    mean_bootstrap,
    mean_t,
    positive_mean_t,
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


@hypothesis.given(
    arrays(float, st.integers(2, 30), elements=st.floats(0, 1e6)), st.floats(1e-6, 1e6)
)
def test_an_interval_of_positive_figures_is_one_of_their_logarithm(
    values: np.ndarray, scale: float
):
    hypothesis.assume(values.mean() > 1e-3)
    value, low, high = positive_mean_t(values)
    assert 0 < low <= value <= high
    # Its logarithm is Student's interval of the linearised logarithms.
    linearised = np.log(values.mean()) + values / values.mean() - 1
    assert np.log([value, low, high]) == pytest.approx(mean_t(linearised), rel=1e-9, abs=1e-9)
    # Another unit is another factor of all three.
    assert positive_mean_t(scale * values) == pytest.approx(
        (scale * value, scale * low, scale * high), rel=1e-6
    )


def test_it_is_the_linear_interval_of_the_logarithms_where_figures_vary_little():
    values = 3 * np.random.default_rng(5).lognormal(0, 0.01, 20)
    of_logs = np.exp(mean_t(np.log(values)))
    assert positive_mean_t(values) == pytest.approx(tuple(of_logs), rel=1e-4)
    assert positive_mean_t(values) == pytest.approx(mean_t(values), rel=1e-4)


def test_it_holds_the_mean_where_that_of_the_logarithms_holds_the_geometric_mean():
    values = np.random.default_rng(6).lognormal(0, 1, 4000)
    mean = np.exp(0.5)
    held = positive_mean_t(values)
    assert held.low <= mean <= held.high
    assert np.exp(mean_t(np.log(values)).high) < 0.7 * mean


def test_two_runs_that_differ_have_an_interval_above_nothing():
    two = np.array([0.5, 2.0])
    assert mean_t(two).low < 0 < positive_mean_t(two).low
    assert positive_mean_t(np.zeros(3)) == (0, 0, 0)


@pytest.mark.parametrize(
    ("interval", "spread"),
    [
        (Interval(1.0, 0.9, 1.12), "±0.11"),
        (Interval(1.25, 0.0625, 25.0), "(0.062 to 25)"),
        (Interval(1.0, np.nan, np.nan), ""),
        (Interval(2.0, 2.0, 2.0), "±0"),
    ],
)
def test_a_wide_interval_is_written_with_both_bounds(interval: Interval, spread: str):
    assert interval.spread() == spread


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
