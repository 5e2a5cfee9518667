"""Test the diagnosis of innovations: on consistent runs, and on runs with one planted mistake."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import stats

from concord.results.innovations.channel_test import (
    LEAST_UPDATES,
    channel_test,
    nis_interval,
)
from concord.results.innovations.diagnosis import (
    FALSE_ALARMS,
    Cause,
    Channel,
    Diagnosis,
    diagnose,
)
from tests.experiments.simulated_filter import NAMES, Planted, innovations


def diagnosed(planted: Planted, runs: int, steps: int = 220) -> list[Diagnosis]:
    found, variances = innovations(planted, runs, steps)
    return [_diagnosed(one[20:], variances[20:]) for one in found]


def _diagnosed(found: np.ndarray, variances: np.ndarray) -> Diagnosis:
    channels = []
    for node, name in enumerate(NAMES):
        test = channel_test(found[None, :, node], variances[None, :, node])
        channels.append((Channel(node, 0, 0, name, "m"), test))
    return diagnose(channels)


def test_a_consistent_run_is_accused_as_rarely_as_is_claimed():
    """Bonferroni's bound is an upper one."""
    accused = sum(one.cause is not Cause.NONE for one in diagnosed(Planted(), 400))
    assert stats.binomtest(accused, 400, FALSE_ALARMS, alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    ("planted", "cause", "node"),
    [
        (Planted(noise=(4, 1, 1, 1)), Cause.NOISE_TOO_SMALL, 0),
        (Planted(noise=(1, 1, 0.25, 1)), Cause.NOISE_TOO_LARGE, 2),
        (Planted(noise=(4, 4, 4, 4)), Cause.ALL_NOISE_TOO_SMALL, None),
        (Planted(noise=(0.25, 0.25, 0.25, 0.25)), Cause.ALL_NOISE_TOO_LARGE, None),
        (Planted(offset=(0, 0, 0, 1.0)), Cause.OFFSET, 3),
        (Planted(offset=(-1.0, 0, 0, 0)), Cause.OFFSET, 0),
        (Planted(process=10.0), Cause.PROCESS_NOISE_TOO_SMALL, None),
        (Planted(process=100.0), Cause.PROCESS_NOISE_TOO_SMALL, None),
        (Planted(believed_process=100.0), Cause.PROCESS_NOISE_TOO_LARGE, None),
    ],
)
def test_a_planted_mistake_is_named_in_nine_runs_of_ten(
    planted: Planted, cause: Cause, node: int | None
):
    found = diagnosed(planted, 40)
    named = [
        one
        for one in found
        if one.cause is cause
        and (node is None or (one.channel is not None and one.channel.node == node))
    ]
    assert len(named) >= 36, Counter(one.cause for one in found)


def test_few_readings_are_not_judged():
    (few,) = diagnosed(Planted(offset=(9.0,) * 4), 1, 20 + LEAST_UPDATES - 1)
    (enough,) = diagnosed(Planted(offset=(0, 0, 0, 9.0)), 1, 20 + LEAST_UPDATES)
    assert few.cause is Cause.UNKNOWN and enough.cause is Cause.OFFSET
    assert diagnose([]).cause is Cause.UNKNOWN


def test_p_values_of_white_innovations_are_uniform():
    rng = np.random.default_rng(3)
    found = [
        channel_test(rng.standard_normal((1, 150)) * 3, np.full((1, 150), 9.0)) for _ in range(400)
    ]
    for values in ([one.p_mean for one in found], [one.p_spread for one in found]):
        assert stats.kstest(values, "uniform").pvalue > 1e-3
    # Ljung and Box's law is one of many readings: near 0, where it decides, it is close.
    small = sum(one.p_white < 0.05 for one in found)
    assert 5 <= small <= 40


@pytest.mark.parametrize("runs", [1, 3])
def test_figures_are_those_of_loops(runs: int):
    rng = np.random.default_rng(4)
    values = 0.1 + rng.standard_normal((runs, 60))
    values[:, 7::9] = np.nan
    found = channel_test(values, np.full(values.shape, 1.21))
    known = [row[~np.isnan(row)] / 1.1 for row in values]
    every = [value for row in known for value in row]
    assert found.updates == len(every)
    assert found.nis.value == pytest.approx(sum(v * v for v in every) / len(every))
    assert found.spread == pytest.approx(np.var(every, ddof=1))
    student: Any = stats.ttest_1samp(every, 0)
    assert found.p_mean == pytest.approx(student.pvalue)
    mean = np.mean(every)
    pairs = sum((a - mean) * (b - mean) for row in known for a, b in pairwise(row))
    assert found.correlation == pytest.approx(pairs / sum((v - mean) ** 2 for v in every))


def test_the_interval_of_nis_covers_a_variance():
    rng = np.random.default_rng(5)
    squares = rng.chisquare(30, 1000)
    intervals = [nis_interval(total, 30) for total in squares]
    covered = sum(one.low <= 1 <= one.high for one in intervals)
    assert stats.binomtest(covered, 1000, 0.95).pvalue > 1e-3


def test_far_readings_of_a_filter_that_believes_in_more_noise_are_no_outliers():
    """A gate refuses none of them: it is as wide as the filter believes."""
    found = 0.15 * np.random.default_rng(3).standard_normal(400)
    found[50:58:2] = 1.4
    test = channel_test(found[None], np.ones((1, 400)))
    assert test.far == 4 and test.nis.high < 1
    assert diagnose([(Channel(0, 0, 0, "angle", "rad"), test)]).cause is Cause.NOISE_TOO_LARGE


@pytest.mark.parametrize("spread", [0.9, 1.0, 1.15])
def test_the_p_of_a_spread_is_that_of_chi_square_on_both_sides(spread: float):
    values = spread * np.random.default_rng(3).normal(size=(2, 150)) + 0.4
    squares, freedoms = float(((values - values.mean()) ** 2).sum()), values.size - 1
    law = stats.chi2(freedoms)
    expected = 2 * min(law.cdf(squares), law.sf(squares))
    assert channel_test(values, np.ones_like(values)).p_spread == pytest.approx(expected)
