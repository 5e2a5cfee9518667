"""Own plants behind a measurement bus: every kind of plant, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.options import SensorSlots
from concord.features.measurement_bus.own_measured import on_a_measurement_bus
from concord.features.measurement_bus.sensed import sensors_on_a_bus
from concord.features.sets.bounded_plant import BoundedOutput, BoundedPlant
from concord.features.sets.options import EllipsoidReceiver
from concord.filters.metrics import nees
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.buses import FlexRay
from tests.experiments.support import scenario

LINEAR = OwnPlant(f=lambda x: 0.9 * x, Q=[0.1, 0.2], mean=[1.0, -1.0], cov=[1.0, 2.0])
FIRST = OwnSensor(h=lambda x: x[..., :1], R=0.1)
BOTH = OwnSensor(h=lambda x: x, R=[0.2, 0.3])
BOUNDED = BoundedPlant(
    A=lambda step: np.array([[0.9, 0.1 * np.cos(step)], [0.0, 0.8]]),
    B=np.eye(2, 4),
    W=[0.01, 0.02, 0.01, 0.01],
    mean=[1.0, -1.0],
    shape=[1.0, 2.0],
)
STRIPS = [
    BoundedOutput(C=[1.0, 0.0], D=[0.0, 0.0, 1.0, 0.0]),
    BoundedOutput(C=[0.0, 1.0], D=[0.0, 0.0, 0.0, 1.0]),
    BoundedOutput(C=[1.0, 1.0], D=[0.0, 0.0, 1.0, 1.0]),
]


def run(asked: Scenario) -> Trace:
    setup = prepare(asked)
    return read_trace(setup, in_memory(setup))


def test_a_linear_plant_with_all_sensors_heard_is_the_textbooks_kalman_filter():
    made = on_a_measurement_bus(LINEAR, [FIRST, BOTH], receiver="kf", steps=12)
    trace = run(made.with_(schedule="full"))
    C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    R, Q = np.diag([0.1, 0.2, 0.3]), np.diag([0.1, 0.2])
    mean, cov = np.array([1.0, -1.0]), np.diag([1.0, 2.0])
    for step in range(12):
        if step:
            mean, cov = 0.9 * mean, 0.81 * cov + Q
        y = np.concatenate([trace.readings[step, 1, 0, :1], trace.readings[step, 2, 0, :2]])
        gain = cov @ C.T @ np.linalg.inv(C @ cov @ C.T + R)
        mean, cov = mean + gain @ (y - C @ mean), (np.eye(2) - gain @ C) @ cov
        np.testing.assert_allclose(trace.mean[step, 0], mean, atol=1e-9)
        np.testing.assert_allclose(trace.cov[step, 0], cov, atol=1e-9)


def test_the_example_of_meng_is_one_of_these():
    plant = meng2025.plant(sensors_on_a_bus(6))
    own = on_a_measurement_bus(
        plant, bus=FlexRay(schedule=SensorSlots(static_slots=4)), steps=20, first_scored_step=1
    )
    ours, named = run(own), run(prepare(scenario("meng2025", steps=20)).scenario)
    np.testing.assert_array_equal(ours.truth, named.truth)
    # The points of the named scenario are the paper's.
    np.testing.assert_array_equal(ours.published, named.published)
    assert np.abs(ours.mean[:, 0] - named.mean[:, 0]).max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["tight", "fast-rate", "paper", "fast", "zonotope"])
def test_every_set_of_a_bounded_plant_holds_the_truth(receiver: str):
    chosen: Any = receiver if receiver == "zonotope" else EllipsoidReceiver(method=receiver)  # type: ignore[arg-type]
    for seed in range(3):
        made = on_a_measurement_bus(BOUNDED, STRIPS, receiver=chosen, steps=30)
        trace = run(made.with_(seed=seed, loss=0.2))
        radii = nees(trace.mean[:, 0] - trace.truth, trace.cov[:, 0])
        assert (radii <= 1.0).all()


@pytest.mark.parametrize("receiver", ["tight", "fast-rate", "zonotope"])
@pytest.mark.parametrize("shape", [[1.0, 0.0], [0.0, 0.0]])
def test_a_first_set_may_be_flat_or_a_point(receiver: str, shape: list[float]):
    chosen: Any = receiver if receiver == "zonotope" else EllipsoidReceiver(method=receiver)  # type: ignore[arg-type]
    plant = replace(BOUNDED, shape=shape)
    trace = run(on_a_measurement_bus(plant, STRIPS, receiver=chosen, steps=12))
    assert np.isfinite(trace.mean[:, 0]).all()
    radii = nees(trace.mean[1:, 0] - trace.truth[1:], trace.cov[1:, 0])
    assert (radii <= 1.0).all()


def test_weights_by_sensor_and_step_decide_who_sends():
    def heavy(step: int) -> list[float]:
        return [1e9 if sensor == step % 3 else 1.0 for sensor in range(3)]

    bus = FlexRay(schedule=SensorSlots(static_slots=0))
    made = on_a_measurement_bus(BOUNDED, STRIPS, bus, "kf", weights=heavy, steps=9)
    sent = run(made).published[:, 0, 1:].argmax(-1)
    assert sent.tolist() == [step % 3 for step in range(9)]
    asked = run(made.with_(bid_weights="1e9 1 1; 1 1e9 1; 1 1 1e9"))
    np.testing.assert_array_equal(asked.published[:, 0, 1:].argmax(-1), sent)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: on_a_measurement_bus(LINEAR, STRIPS), "an OwnPlant takes OwnSensor"),
        (lambda: on_a_measurement_bus(BOUNDED, []), "give at least one BoundedOutput"),
        (lambda: on_a_measurement_bus("motor", []), "plant of type str: give an OwnPlant"),  # type: ignore[arg-type]
        (
            lambda: on_a_measurement_bus(LINEAR, [FIRST, BOTH], receiver="zonotope"),
            "has no bound.*use a BoundedPlant",
        ),
        (
            lambda: on_a_measurement_bus(LINEAR, [FIRST, BOTH], weights=[1.0]),
            "weights: 1 for 2 sensors",
        ),
        (
            lambda: on_a_measurement_bus(LINEAR, [FIRST, BOTH], weights=[1.0, -1.0]),
            "must be a positive number or a positive definite matrix",
        ),
        (
            lambda: BoundedPlant(A=np.eye(2), B=np.eye(3), W=np.ones(3), mean=[0, 0], shape=[1, 1]),
            r"B of shape \(3, 3\): must be finite and of shape \(2, 3\)",
        ),
        (
            lambda: BoundedPlant(A=[[1.0]], B=[[1.0]], W=[0.0], mean=[0], shape=[1]),
            "W: must be positive definite",
        ),
    ],
)
def test_what_cannot_be(call: Any, says: str):
    with pytest.raises(ValueError, match=says):
        call()


def test_a_singular_prior_is_refused_where_a_filter_cannot_compute_with_it():
    known = OwnPlant(f=lambda x: 0.9 * x, Q=[0.1, 0.2], mean=[1.0, -1.0], cov=[0.0, 2.0])
    for receiver in ("recommended", "ukf"):
        made = on_a_measurement_bus(known, [FIRST, BOTH], receiver=receiver, steps=5)
        with pytest.raises(ValueError, match="the covariance of the prior is singular"):
            prepare(made)
    made = on_a_measurement_bus(known, [FIRST, BOTH], receiver="kf", steps=5)
    assert np.isfinite(run(made).mean[:, 0]).all()
