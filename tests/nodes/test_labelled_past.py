"""The smoothed past of the rule `labelled`: that of exactly the records that a node holds."""

import numpy as np
import pytest

from concord.nodes.rules.local_filter import Model
from concord.results.figures.smoothed_errors import lagged, shown_lags
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised, centralised_past
from concord.scenarios.catalogue import definition_of
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.simulate import simulate

EXACT = {"rule": "labelled", "record_number": "float64", "stretch": 100.0}


def oscillator(**options: object) -> Scenario:
    return scenario_of("oscillator", **EXACT, **options)


def test_with_all_records_it_is_the_past_of_the_centralised_smoother():
    setup = prepare(oscillator(nodes=4, graph="complete", rounds=1, steps=9, smooth_steps=5))
    trace = read_trace(setup, in_memory(setup))
    central = centralised(setup, trace.readings, None)
    expected = centralised_past(setup, type(central)(*(one[None] for one in central)), None, 5)
    assert trace.past is not None
    for node in range(4):
        found = trace.past.mean[:, :, node]
        np.testing.assert_allclose(found, expected.mean[:, 0].swapaxes(0, 1), atol=1e-12)
        std = np.sqrt(np.diagonal(expected.cov[:, 0], axis1=-2, axis2=-1)).swapaxes(0, 1)
        np.testing.assert_allclose(trace.past.std[:, :, node], std, atol=1e-12)


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_late_records_improve_exactly_the_steps_that_they_are_of(loss: float):
    """One least-squares problem over the records that a node held after each step."""
    asked = oscillator(nodes=5, graph="path", rounds=1, steps=8, smooth_steps=6, loss=loss)
    setup = prepare(asked)
    trace = read_trace(setup, in_memory(setup))
    assert trace.past is not None and trace.spread is not None
    arrival = trace.spread.arrival_steps
    assert (arrival[0, :, 4] != np.arange(8)).any(), "no record is late"
    for step, node in [(7, 0), (7, 4), (5, 2), (2, 0)]:
        held = (arrival[node] >= 0) & (arrival[node] <= step)
        mean, std = least_squares(setup, trace.readings, held[: step + 1])
        for lag in range(min(step, 6) + 1):
            np.testing.assert_allclose(
                trace.past.mean[step, lag, node], mean[step - lag], atol=1e-9
            )
            np.testing.assert_allclose(trace.past.std[step, lag, node], std[step - lag], atol=1e-9)


def least_squares(
    setup: Setup, readings: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (K, 2) of all states from the records `held` (K, N)."""
    definition = definition_of(setup.scenario)
    model: Model = definition.model(setup.scenario)
    steps, n = len(held), len(setup.prior_mean)
    prior_cov, mean = np.array(setup.prior_cov), np.array(setup.prior_mean)
    information = np.zeros((n * steps, n * steps))
    vector = np.zeros(n * steps)
    information[:n, :n] = np.linalg.inv(prior_cov)
    vector[:n] = information[:n, :n] @ mean
    for step in range(1, steps):
        F = np.stack([model.transition(unit, None, step - 1) for unit in np.eye(n)], axis=1)
        both = np.hstack([-F, np.eye(n)])
        here = slice(n * (step - 1), n * (step + 1))
        noise_cov = model.process_noise_cov(step - 1)
        information[here, here] += both.T @ np.linalg.inv(noise_cov) @ both
    for step, node in np.argwhere(held):
        sensor = definition.sensor(setup.scenario, node)
        assert sensor is not None
        value, cov = sensor.interpret(readings[step, node, 0])
        H = np.stack([sensor.measure(unit, step) for unit in np.eye(n)], axis=1)
        here = slice(n * step, n * (step + 1))
        information[here, here] += H.T @ np.linalg.inv(cov) @ H
        vector[here] += H.T @ np.linalg.inv(cov) @ value
    cov = np.linalg.inv(information)
    return (cov @ vector).reshape(steps, n), np.sqrt(np.diagonal(cov)).reshape(steps, n)


@pytest.mark.parametrize(
    "options",
    [
        {"loss": 0.3, "occupancy": 0.3, "schedule": "dynamic"},
        {"window_steps": 4, "occupancy": 0.3, "relay": True},
        {"changes": ("3 kill 2", "5 loss 0.4", "7 set rule=ci")},
    ],
)
def test_drivers_agree(options: dict):
    asked = scenario_of(
        "target-tracking", nodes=6, graph="ring", rule="labelled", steps=10, smooth_steps=3,
        stretch=100.0, **options,
    )  # fmt: skip
    setup = prepare(asked)
    past = simulate(setup, [0, 2], keep=()).past
    assert past is not None
    for place, run in enumerate([0, 2]):
        own = setup_of_run(setup, run)
        expected = read_trace(own, in_memory(own)).past
        assert expected is not None
        for found, one in zip(past, expected, strict=True):
            np.testing.assert_allclose(found[place], one, rtol=1e-6, atol=1e-6)
    assert not np.isnan(past.mean[:, 4, :4, 0]).any()


def test_the_estimate_of_the_step_itself_is_the_first_of_the_past():
    asked = oscillator(nodes=3, graph="path", steps=6, smooth_steps=2)
    histories = simulate(prepare(asked), [0])
    assert histories.past is not None
    np.testing.assert_array_equal(histories.past.mean[:, :, 0], histories.mean)
    assert simulate(prepare(asked.with_(smooth_steps=0)), [0]).past is None


def test_a_past_beyond_the_window_is_refused():
    with pytest.raises(ValueError, match=r"--smooth-steps 4: must be below 4.*--window-steps"):
        prepare(oscillator(nodes=3, graph="path", steps=6, smooth_steps=4, window_steps=4))


def test_values_of_steps_before():
    values = np.arange(4.0)[None]
    nan = np.nan
    expected = [[[0, nan, nan], [1, 0, nan], [2, 1, 0], [3, 2, 1]]]
    np.testing.assert_array_equal(lagged(values, 3), expected)
    assert shown_lags(7) == [0, 1, 2, 4, 6] and shown_lags(1) == [0]
