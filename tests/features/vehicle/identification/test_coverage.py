"""Intervals hold the truth as often as they claim: over fresh logs of the model itself."""

import numpy as np
import pytest

from concord.features.vehicle.identification.likelihood import likelihood, widths_of
from concord.features.vehicle.identification.logged_readings import logged_readings
from concord.features.vehicle.identification.sought import sought_of
from concord.features.vehicle.plant.drive_log import channels_of
from concord.features.vehicle.plant.model import tanh_tyre
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log


@pytest.mark.study
def test_scores_at_the_truth_are_as_large_as_their_scatter_says():
    """An interval holds the truth where the score there is within its own interval about 0.

    Ten logs, 25 values each.
    """
    held = []
    for seed in range(2001, 2011):
        channels = channels_of(simulated_log(TRUE, 4.0, seed)[0])
        every = sought_of(channels, TRUE, friction=False, ratio=False)
        log, zero = logged_readings(channels, TRUE, 0.005, 5.0), np.zeros(len(every))
        widths = widths_of(log, tanh_tyre, every, zero)
        here = likelihood(log, tanh_tyre, every, zero, widths)
        held.append(np.abs(here.gradient) < 1.96 * np.sqrt(np.diagonal(here.scatter)))
    assert 0.91 < np.mean(held) < 0.99, np.mean(held, axis=0)
