"""Records that a source withholds exist nowhere, and are those that change a prediction little."""

from dataclasses import replace
from typing import Any

import numpy as np

from concord.bus.schedule import full_publish
from tests.nodes.labelled_networks import PRIOR, kalman, labelled, taken
from tests.nodes.networks import path, run
from tests.nodes.rule_networks import F, Q, noise_cov

STEPS, NODES, BOUND_NATS = 30, 3, 0.25


def divergence(mean: np.ndarray, cov: np.ndarray, gain: np.ndarray, news: np.ndarray) -> float:
    """In nats, of the belief after news from that before: written with plain inverses."""
    shift, shrink = gain @ news, np.eye(len(mean)) - gain
    distance = shift @ np.linalg.inv(cov) @ shift
    return 0.5 * (distance + np.trace(shrink) - len(mean) - np.log(np.linalg.det(shrink)))


def worth_telling(readings: dict[tuple[int, int], np.ndarray]) -> list[tuple[int, int]]:
    """The labels that change the prediction of all that was told before by the bound at least."""
    mean, cov = PRIOR
    told: list[tuple[int, int]] = []
    for step in range(STEPS):
        if step:
            mean, cov = F @ mean, F @ cov @ F.T + Q
        before = mean, cov
        for node in range(NODES):
            news = readings[step, node].ravel() - before[0]
            gain = before[1] @ np.linalg.inv(before[1] + noise_cov(node))
            if divergence(*before, gain, news) < BOUND_NATS:
                continue
            told.append((step, node))
            gain = cov @ np.linalg.inv(cov + noise_cov(node))
            mean = mean + gain @ (readings[step, node].ravel() - mean)
            cov = (np.eye(2) - gain) @ cov
    return told


def test_every_node_has_the_filter_of_the_records_worth_telling():
    """Two rounds carry a record over the path, so all nodes predict alike."""
    net = labelled(
        path(NODES), steps=STEPS, rounds=2, seeing=range(NODES), schedule=full_publish(NODES)
    )
    nodes = []
    for config in net.nodes:
        estimator: Any = config.estimator
        nodes.append(replace(config, estimator=replace(estimator, withhold_below=BOUND_NATS)))
    outcome = run(net._replace(nodes=nodes))
    readings = taken(outcome)
    told = worth_telling(readings)
    assert 5 < len(told) < STEPS * NODES - 5
    assert outcome.counted("withheld") == STEPS * NODES - len(told)
    expected = kalman(net, readings, told)
    for node in range(NODES):
        np.testing.assert_allclose(outcome.mean[-1, node], expected.mean, rtol=0, atol=1e-9)
