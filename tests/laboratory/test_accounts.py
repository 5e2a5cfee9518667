"""Test the figures on returns after a kill and on those that stayed, with invented ones."""

import numpy as np
import pytest

from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.support import small
from tests.laboratory.accounts import consistency_of_survivors, cycles_to_agree

pytestmark = pytest.mark.slow


def test_a_node_agrees_again_in_the_step_in_which_it_is_as_near_as_others_are():
    mean = np.random.default_rng(0).normal(0.0, 0.1, (40, 5, 1))
    mean[10:13, 2] = np.nan
    mean[13:16, 2, 0] = 5.0, 3.0, 0.0  # far away for two steps
    mean[20, 3] = np.nan
    mean[21, 3] = 0.0  # near at once
    mean[30, 4] = np.nan
    mean[31, 4] = 9.0  # out again while it is far away
    mean[32, 4] = np.nan
    mean[33, 4] = 0.0
    assert cycles_to_agree(mean, rounds=3).tolist() == [9.0, 3.0, np.inf, 3.0]


def test_the_consistency_is_that_of_nodes_that_stayed():
    setup = small(steps=400)
    nees = simulate(setup, [77], keep=()).nees[0]
    taking_part = np.ones(nees.shape, dtype=bool)
    calm = consistency_of_survivors(setup, nees, taking_part)
    # Nodes that come back are too sure of themselves; they do not count for ten steps.
    taking_part[100::20, 2] = False
    back = nees.copy()
    for step in range(100, 400, 20):
        back[step : step + 10, 2] = 1e3
    spared = consistency_of_survivors(setup, back, taking_part)
    liars = consistency_of_survivors(setup, 100 * nees, taking_part)
    assert share(calm) > 85 and share(spared) > 85 and share(liars) < 15


def share(text: str) -> float:
    """The percentage of steps in the range."""
    return float(text.partition("in ")[2].partition("%")[0])
