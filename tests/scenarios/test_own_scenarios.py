"""Own scenarios in all drivers: rates, delays, inputs, and a truth that the filters do not know."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor, TrueSensor
from concord.plants.own_truth import TruePlant as Truth
from concord.results.figures.summary import summarise
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.definitions.own import own_scenario
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.studies.monte_carlo.simulate import AGES, INNOVATIONS, READINGS, simulate
from tests.test_batched_agreement import check_agreement

STEP_S = 0.1
STEPS = 40
MOVE = np.array([[1.0, STEP_S], [0.0, 0.98]])
THRUST = np.sin(0.3 * np.arange(400))
CART = OwnPlant(
    f=lambda x, u: x @ MOVE.T + STEP_S * u * np.array([0.0, 1.0]),
    Q=[1e-5, 1e-3],
    mean=[0, 0],
    cov=[1, 1],
    time_step_s=STEP_S,
    inputs=THRUST,
    state_units=("m", "m/s"),
)
PLACE = partial(OwnSensor, h=lambda x: x[..., :1], R=0.04)
SPEED = partial(OwnSensor, h=lambda x: x[..., 1:], R=0.01)
GPS, ODOMETER = PLACE(name="gps", every_s=0.4, start_s=0.2, missing=0.2), SPEED(every_s=0.2)
EXACT = {"number": "float64"}


def cart(sensors: list, **options: Any) -> Scenario:
    return own_scenario(CART, sensors, steps=STEPS).with_(**options)


def traced(asked: Scenario) -> Trace:
    setup = prepare(asked)
    return read_trace(setup, in_memory(setup))


def kalman(trace: Trace, node: int) -> np.ndarray:
    """Means (steps, 2) of a plain Kalman filter of one node's readings (place, speed), at once."""
    mean, cov, means = np.zeros(2), np.eye(2), []
    for k, ((reading,), u) in enumerate(zip(trace.readings[:, node], THRUST, strict=False)):
        for entry, variance in ((0, 0.04), (1, 0.01)):
            if np.isfinite(reading[entry]):
                gain = cov[:, entry] / (cov[entry, entry] + variance)
                mean = mean + gain * (reading[entry] - mean[entry])
                cov = cov - np.outer(gain, cov[entry])
        means.append(mean)
        mean = MOVE @ mean + [0, STEP_S * u]
        cov = MOVE @ cov @ MOVE.T + np.diag([1e-5, 1e-3])
        assert k < STEPS
    return np.array(means)


def test_a_node_of_several_sensors_is_a_kalman_filter_of_what_came():
    trace = traced(cart([[GPS, ODOMETER], None], nodes=2, rule="local", **EXACT))
    assert np.isnan(trace.readings[:, 0]).any() and np.isfinite(trace.readings[:, 0]).any()
    np.testing.assert_allclose(trace.mean[:, 0], kalman(trace, 0), atol=1e-9)


@pytest.mark.parametrize("rule", ["ci", "labelled"])
def test_the_drivers_agree_on_rates_inputs_and_what_is_missing(rule: str):
    check_agreement(cart([GPS, [ODOMETER, PLACE(every_s=1.0)], None], nodes=4, rule=rule))


def test_late_readings_are_put_back_by_labelled():
    """Nodes that hear all have, once a reading can have come, what they had had at once."""
    late = PLACE(name="gps", every_s=0.4, delay_s=0.25)
    options = {"nodes": 3, "graph": "complete", "rule": "labelled", "window_steps": 8}
    check_agreement(cart([late, ODOMETER, None], **options))
    at_once, delayed = (
        traced(cart([one, ODOMETER, None], **options, record_number="float64"))
        for one in (PLACE(name="gps", every_s=0.4), late)
    )
    np.testing.assert_array_equal(at_once.readings, delayed.readings)
    # Three steps after a reading, and before the next, it has come and nothing newer is under way.
    caught_up = np.arange(3, STEPS, 4)
    np.testing.assert_allclose(
        delayed.mean[caught_up], at_once.mean[caught_up], rtol=1e-6, atol=1e-6
    )
    assert np.abs(delayed.mean - at_once.mean).max() > 1e-3


@pytest.mark.parametrize(
    ("sensors", "options", "says"),
    [
        ([PLACE(delay_s=0.2)], {"rule": "ci"}, "delay_s: rule ci has no window"),
        ([PLACE(delay_s=0.2, gate=0.99)], {"rule": "labelled"}, "leave the gate of late sensors"),
        ([PLACE(delay_s=2.0)], {"rule": "labelled", "window_steps": 6}, "up to 20 steps late"),
        ([PLACE()], {"steps": 402}, "--steps 402: inputs has 400 rows, enough for 401 steps"),
    ],
)
def test_what_a_network_cannot_use_is_refused(sensors: list, options: dict, says: str):
    with pytest.raises(ValueError, match=says):
        prepare(cart(sensors, **options))


MANY = [PLACE(name=f"gps{one}") for one in "abc"] + [SPEED(name="odometer"), None]


def planted(**true: Any) -> Truth:
    """The truth of the first sensor alone."""
    return Truth(sensors=[TrueSensor(**true), *(None,) * 4])


@pytest.mark.parametrize(
    ("truth", "cause", "says"),
    [
        (Truth(), "consistent", "models and sensors fit the readings"),
        (Truth(Q=[1e-5, 0.3]), "process noise too small", "raise Q"),
        (Truth(Q=[1e-7, 1e-5]), "process noise too large", "lower it"),
        (planted(bias=0.6), "offset of a sensor", "node 0's gpsa 0 is"),
        (planted(R=0.6), "noise of a sensor too small", "node 0's gpsa 0 is"),
        (planted(R=0.004), "noise of a sensor too large", "node 0's gpsa 0 is"),
        (planted(outlier_share=0.03, outlier_scale=30), "outliers of a sensor", "are outliers"),
        (Truth(f=lambda x, u: x @ MOVE.T), "process noise too small", "or the model lacks a part"),
        (Truth(sensors=[*(TrueSensor(bias=0.6),) * 3, None, None]), "hidden error",
         "an offset that all sensors of a state share"),
    ],
    ids=["as-believed", "Q", "less-Q", "bias", "R", "less-R", "outliers", "no-input", "all"],
)  # fmt: skip
def test_the_verdict_names_what_was_planted(truth: Truth, cause: str, says: str):
    asked = own_scenario(CART, MANY, truth=truth, graph="complete", steps=80)
    setup = prepare(asked.with_(rule="labelled", rounds=1, bus="ideal"))
    found = summarise(simulate(setup, range(24), keep=(READINGS, AGES, INNOVATIONS)))
    assert (found.verdict.cause, says in found.verdict.said) == (cause, True), found.verdict.said
