"""The filters that frame a network, on a linear plant where the Kalman filter is the oracle."""

import numpy as np
import pytest

from concord.filters.gaussian import Gaussian
from concord.plants.oscillator import Oscillation, Oscillator
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import (
    centralised,
    centralised_of_runs,
    local_only,
    local_only_of_runs,
)
from concord.scenarios.preparation import setup_of_run
from concord.scenarios.setup import Setup
from tests.experiments.support import small

SETUP = small(steps=40, nodes=5)
TRACE = read_trace(SETUP, in_memory(SETUP))
MODEL = Oscillation()


def kalman(setup: Setup, trace: Trace, nodes: list[int]) -> Gaussian:
    """The textbook filter with the readings of some nodes, one after the other."""
    plant = Oscillator(setup.scenario.nodes)
    mean, cov = np.array(setup.prior_mean), np.array(setup.prior_cov)
    F, Q = MODEL.transition_matrix, MODEL.process_noise_cov(0)
    means, covs = [], []
    for step in range(trace.steps):
        if step:
            mean, cov = F @ mean, F @ cov @ F.T + Q
        for node in nodes:
            reading = trace.readings[step, node, 0, 0]
            if np.isnan(reading):
                continue
            sensor = plant.sensor(node)
            H, R = sensor.row[None], float(sensor.noise_std) ** 2
            gain = cov @ H.T / (H @ cov @ H.T + R)
            mean = mean + gain[:, 0] * (reading - H[0] @ mean)
            cov = (np.eye(2) - gain @ H) @ cov
        means.append(mean)
        covs.append(cov)
    return Gaussian(np.array(means), np.array(covs))


def assert_close(found: Gaussian, expected: Gaussian) -> None:
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-9, atol=1e-11)


def test_the_centralised_filter_is_the_kalman_filter_of_all_readings():
    found = centralised(SETUP, TRACE.readings, TRACE.control)
    assert_close(found, kalman(SETUP, TRACE, list(range(5))))


def test_a_node_alone_is_the_kalman_filter_of_its_own_readings():
    found = local_only(SETUP, TRACE.readings, TRACE.control)
    for node in range(5):
        alone = Gaussian(found.mean[:, node], found.cov[:, node])
        assert_close(alone, kalman(SETUP, TRACE, [node]))


@pytest.mark.parametrize("name", ["target-tracking", "dc-motor-position", "liu2021-network"])
def test_many_runs_at_once_are_the_runs_one_by_one(name: str):
    """Each run has other nodes that see the target."""
    setup = small(name, steps=6)
    runs = [0, 2, 5]
    traces = [read_trace(one, in_memory(one)) for one in (setup_of_run(setup, r) for r in runs)]
    readings = np.stack([trace.readings for trace in traces])
    controls = [trace.control for trace in traces if trace.control is not None]
    control = np.stack(controls) if controls else None
    for together, alone in ((centralised_of_runs, centralised), (local_only_of_runs, local_only)):
        found = together(setup, runs, readings, control)
        for place, run in enumerate(runs):
            driven = None if control is None else control[place]
            expected = alone(setup_of_run(setup, run), readings[place], driven)
            assert_close(Gaussian(found.mean[place], found.cov[place]), expected)
