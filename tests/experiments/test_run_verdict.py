"""The verdict on a run: its interval covers as often as it says, and its words follow from it."""

import numpy as np
import pytest
from scipy import signal, stats

from concord.results.figures.intervals import Interval
from concord.results.run_verdict import (
    BATCHES,
    anees_interval,
    consistency_in_words,
    verdict,
)


@pytest.mark.parametrize("memory", [0.0, 0.6])
def test_the_interval_covers_the_mean_of_steps_that_depend_on_each_other(memory: float):
    """Normalised errors with one step's memory have a mean square of 1; 400 runs of 400 steps."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((400, 500)) * np.sqrt(1 - memory**2)
    errors = np.asarray(signal.lfilter([1.0], [1.0, -memory], noise, axis=1))[:, 100:]
    intervals = [anees_interval(row**2) for row in errors]
    covered = sum(one.low <= 1 <= one.high for one in intervals)
    # Batch means cover less than 95 % where batches still depend on each other a little.
    assert stats.binomtest(covered, 400, 0.93).pvalue > 1e-3
    # An overconfident filter, whose errors are twice what it claims, is found.
    assert all(anees_interval(4 * row**2).low > 1 for row in errors)


def test_too_few_steps_have_no_interval():
    found = anees_interval(np.ones(2 * BATCHES - 1))
    assert found.value == 1 and np.isnan([found.low, found.high]).all()
    assert np.isnan(anees_interval(np.full(50, np.nan)).value)


@pytest.mark.parametrize(
    ("interval", "says"),
    [
        (Interval(2.0, 1.1, 3.0), "overconfident (ANEES 2, 95 %: 1.1 to 3)"),
        (Interval(0.5, 0.3, 0.9), "underconfident (ANEES 0.5, 95 %: 0.3 to 0.9)"),
        (Interval(1.2, 0.9, 1.6), "neither over- nor underconfident"),
        (Interval(1.2, np.nan, np.nan), "too few scored steps"),
        (Interval(np.nan, np.nan, np.nan), "of unknown consistency"),
    ],
)
def test_words_follow_from_the_interval(interval: Interval, says: str):
    assert consistency_in_words(interval).startswith(says)


def test_errors_are_compared_with_the_best_and_with_none():
    anees = Interval(1.0, 0.9, 1.1)
    assert verdict(1.1, 1.0, 23.1, anees).startswith(
        "network: 1.1 x the error of the filter that hears everything, 21 x better than alone, "
    )
    assert ", 2 x that alone, " in verdict(2.0, 1.0, 1.0, anees)
    assert "truth is not known" in verdict(np.nan, 1.0, 1.0, anees)
