"""Outliers are judged once, at their source, and what is refused exists nowhere."""

from dataclasses import replace
from typing import Any

import numpy as np

from concord.bus.schedule import full_publish
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured
from concord.nodes.rules.labelled.source_gate import without_outliers
from tests.nodes.labelled_networks import PRIOR, kalman, labelled, lone, taken
from tests.nodes.networks import WholeState, path, run


def test_an_outlier_is_refused_alike_everywhere():
    """Node 1 sometimes reads nonsense; each node equals the filter without those readings."""
    net = labelled(
        path(3), steps=20, rounds=2, seeing=[0, 1, 2], schedule=full_publish(3),
        gates={0: 25.0, 1: 25.0, 2: 25.0},
    )  # fmt: skip
    draws: Any = net.environment.draws
    wrong = [5, 11]
    draws.measurement[wrong, 1, 0] += 100.0
    outcome = run(net)
    readings = taken(outcome)
    good = [label for label in readings if label not in {(t, 1) for t in wrong}]
    expected = kalman(net, readings, good)
    assert outcome.counted("gated") == len(wrong)
    for node in range(3):
        np.testing.assert_allclose(outcome.mean[-1, node], expected.mean, rtol=0, atol=1e-9)
    ungated = labelled(path(3), steps=20, rounds=2, seeing=[0, 1, 2], schedule=full_publish(3))
    spoiled = run(ungated._replace(environment=net.environment))
    assert np.abs(spoiled.mean[wrong] - outcome.mean[wrong]).max() > 1.0


def test_a_gate_counts_the_noise_that_grows_with_the_state():
    """A reading that a sensor of constant noise would refuse."""

    class Louder(WholeState):
        def state_noise_cov(self, belief: Gaussian, step: int) -> np.ndarray:
            return 100.0 * np.eye(2)

    own_filter = lone([1]).filter.filter
    far = np.array([[PRIOR.mean[0] + 20.0, PRIOR.mean[1]]])
    cases = [(WholeState(np.eye(2), 9.0), 1), (Louder(np.eye(2), 9.0), 0)]
    for sensor, expected in cases:
        _, gated, _ = without_outliers(PRIOR, far, sensor, 0, own_filter)
        assert gated == expected
    # A sensor without a gate is judged by the thresholds for as many entries as were taken.
    for gates, expected in (((1e3, 9.0), 1), ((9.0, 1e3), 0), ((), 0)):
        _, gated, _ = without_outliers(PRIOR, far, WholeState(np.eye(2)), 0, own_filter, gates)
        assert gated == expected


def test_a_node_that_knows_nothing_refuses_nothing():
    estimator = replace(lone([1]), gates=(1e-6, 1e-6))
    content, failures = estimator.begin_step(estimator.start(), Measured(1, 0, [[9.0, 9.0]]))
    assert failures == ("gated",)
    content, _ = estimator.fuse(content, (None, None))
    lost = estimator.restart(PRIOR, content)
    _, failures = estimator.begin_step(lost, Measured(1, 1, [[9.0, 9.0]]))
    assert failures == ()
