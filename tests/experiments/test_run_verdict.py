"""The interval of a mean over the steps of one run covers as often as it says."""

import numpy as np
import pytest
from scipy import signal, stats

from concord.results.figures.intervals import BATCHES, batch_means


@pytest.mark.parametrize("memory", [0.0, 0.6])
def test_the_interval_covers_the_mean_of_steps_that_depend_on_each_other(memory: float):
    """Normalised errors with one step's memory have a mean square of 1; 400 runs of 400 steps."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((400, 500)) * np.sqrt(1 - memory**2)
    errors = np.asarray(signal.lfilter([1.0], [1.0, -memory], noise, axis=1))[:, 100:]
    intervals = [batch_means(row**2) for row in errors]
    covered = sum(one.low <= 1 <= one.high for one in intervals)
    # Batch means cover less than 95 % where batches still depend on each other a little.
    assert stats.binomtest(covered, 400, 0.93).pvalue > 1e-3
    # An overconfident filter, whose errors are twice what it claims, is found.
    assert all(batch_means(4 * row**2).low > 1 for row in errors)


def test_too_few_steps_have_no_interval():
    found = batch_means(np.ones(2 * BATCHES - 1))
    assert found.value == 1 and np.isnan([found.low, found.high]).all()
    assert np.isnan(batch_means(np.full(50, np.nan)).value)
