"""Test the figures on returns after a kill with invented returns."""

import numpy as np
import pytest

from tests.endurance.kills import cycles_to_agree

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
