"""Averages of beliefs of which one is far off: the sharp ones keep their digits."""

import numpy as np
import pytest

from concord.filters.fusion.averaging import (
    INFORMATION,
    MOMENTS,
    Averaged,
    covariance_intersection,
    weighted_average,
)
from concord.filters.fusion.hold import inverse_volume, times_inverse_volume
from concord.filters.fusion.sharp_intersection import SharpIntersection
from concord.filters.gaussian import Gaussian
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare
from concord.studies.monte_carlo.simulate import simulate

SHARP, TRUTH = 1e-7, 0.3
WEIGHTS = np.array([0.4, 0.3, 0.3])


@pytest.mark.parametrize("ratio", [1e6, 1e12, 1e16, 1e22])
@pytest.mark.parametrize("rule", [INFORMATION, MOMENTS, SharpIntersection()])
def test_a_node_that_knows_nothing_takes_the_digits_of_its_neighbours(rule: Averaged, ratio: float):
    """Two lanes, of which one node is as sharp as the neighbours; either state by itself."""
    far = SHARP * ratio * np.array([1.0, -2.0])
    own = Gaussian(
        np.stack((far, np.full(2, TRUTH))), np.stack((np.diag(far**2), SHARP**2 * np.eye(2)))
    )
    means = TRUTH + SHARP * np.array([[0.5, -0.5], [-0.5, 0.5]])
    others = Gaussian(
        np.broadcast_to(means, (2, 2, 2)), np.broadcast_to(SHARP**2 * np.eye(2), (2, 2, 2, 2))
    )
    fused = rule.fuse(own, others, np.stack((WEIGHTS, WEIGHTS)), True).belief
    # The two neighbours weigh alike, and the far node has a weight of ratio^-2.
    np.testing.assert_allclose(fused.mean, TRUTH, atol=SHARP * (1e-6 + 2 / ratio))


@pytest.mark.parametrize("function", [covariance_intersection, weighted_average])
def test_the_functions_keep_them_too(function):
    means = np.array([[1e9], [TRUTH], [TRUTH]])
    covs = np.array([1e18, SHARP**2, SHARP**2])[:, None, None]
    weights = times_inverse_volume(WEIGHTS, inverse_volume(covs))
    found = function(Gaussian(means, covs), weights)
    np.testing.assert_allclose(found.mean, TRUTH, atol=1e-6 * SHARP)


@pytest.mark.parametrize("rule", ["wac", "ci"])
def test_blind_nodes_far_off_cost_a_network_nothing(rule: str):
    """One round a step, in which a prior of 1e9 meets readings of 1e-4; arrays and messages."""
    plant = OwnPlant(f=lambda x: x, Q=1e-14, mean=[0.0], cov=1e18)
    sensors = [OwnSensor(h=lambda x: x - 0.0, R=1e-8), None]
    made = own_scenario(plant, sensors, nodes=4, steps=2, graph="complete", first_scored_step=0)
    setup = prepare(made.with_(rule=rule, rounds=1))
    trace, histories = read_trace(setup, in_memory(setup)), simulate(setup, [0])
    # The truth itself is known to a rounding of 1e9.
    bound = 5 * 1e-4 + 2 * np.spacing(np.abs(trace.truth).max())
    assert (np.abs(trace.mean[1] - trace.truth[1, None]) < bound).all()
    assert (np.abs(histories.mean[0, 1] - trace.truth[1, None]) < bound).all()
