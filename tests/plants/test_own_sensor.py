"""When own sensors read, several at one node, and what true sensors do beside believed ones."""

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor, TrueSensor, joined
from concord.plants.own_truth import OwnTruth, sensors_of_nodes
from concord.plants.own_truth import TruePlant as Truth
from concord.scenarios.setup import generator
from tests.experiments.support import scenario

PLANT = OwnPlant(f=lambda x: x, Q=[1e-4, 1e-4], mean=[0, 0], cov=[1, 1], time_step_s=0.1)
PLACE = partial(OwnSensor, h=lambda x: x[..., :1], R=0.04)
BOTH = partial(OwnSensor, h=lambda x: x, R=[0.01, 0.09])
STEPS = 4000


def noise(truth: OwnTruth, steps: int = STEPS) -> np.ndarray:
    """Readings (steps, nodes, d) of the state 0."""
    draws = truth.draw(partial(generator, scenario("oscillator")), steps)
    zero = np.zeros(2)
    return np.stack([truth.observe(zero, one, k)[:, 0] for k, one in enumerate(draws.measurement)])


def truth_of(sensors: list, truth: Truth | None = None) -> OwnTruth:
    moving = PLANT if truth is None else truth.plant_of(PLANT)
    return OwnTruth(moving, sensors_of_nodes(PLANT, sensors, truth), PLANT)


def wrong_truth() -> Truth:
    """A truth whose sensor is a number."""
    sensors: Any = [3]
    return Truth(sensors=sensors)


@given(st.integers(10, 60), st.integers(0, 80), st.integers(1, 60))
def test_a_sensor_reads_in_the_steps_nearest_to_its_instants(every: int, start: int, steps: int):
    """In hundredths of a second, with steps of ten; a tie belongs to the earlier step."""
    due = PLACE(every_s=every / 100, start_s=start / 100).due(steps, 0.1)
    instants = [Fraction(start + every * j, 10) for j in range(100)]
    nearest = {int(-((Fraction(1, 2) - instant) // 1)) for instant in instants}
    assert set(np.flatnonzero(due)) == {step for step in nearest if step < steps}


def test_a_sensor_without_a_rate_reads_from_its_start_on():
    assert np.flatnonzero(PLACE(start_s=0.3).due(6, 0.1)).tolist() == [3, 4, 5]


def test_rates_and_missing_readings_leave_the_noise_of_others_as_it_is():
    alone = noise(truth_of([BOTH(), BOTH()]))
    other = noise(truth_of([BOTH(every_s=0.5, missing=0.25), BOTH()]))
    np.testing.assert_array_equal(other[:, 1], alone[:, 1])
    read = np.isfinite(other[:, 0, 0])
    np.testing.assert_array_equal(other[read, 0], alone[read, 0])
    due = np.arange(STEPS) % 5 == 0
    assert not read[~due].any()
    # Of 800 readings a quarter is lost: within four standard deviations of 12.
    assert abs(read.sum() - 600) < 49


def test_the_sensors_of_a_node_are_one_reading():
    one = joined([PLACE(name="gps"), BOTH(angles=(1,), channels=(("u", "m"), ("a", "rad")))])
    assert one.entries == 3 and one.angles == (2,) and one.name == "gps"
    assert one.channels == (("gps 0", ""), ("u", "m"), ("a", "rad"))
    np.testing.assert_array_equal(one.noise_cov, np.diag([0.04, 0.01, 0.09]))
    np.testing.assert_array_equal(one.measure(np.array([[1.0, 2.0]]), 0), [[1, 1, 2]])
    readings = noise(truth_of([[PLACE(every_s=0.2), BOTH(every_s=0.3)]]), 12)[:, 0]
    assert np.flatnonzero(np.isfinite(readings[:, 0])).tolist() == [0, 2, 4, 6, 8, 10]
    assert np.flatnonzero(np.isfinite(readings[:, 1])).tolist() == [0, 3, 6, 9]


@pytest.mark.parametrize(
    ("true", "law"),
    [
        (TrueSensor(), stats.norm(0, 0.2)),
        (TrueSensor(R=0.36), stats.norm(0, 0.6)),
        (TrueSensor(bias=0.5), stats.norm(0.5, 0.2)),
        (TrueSensor(degrees_of_freedom=3), stats.t(3, scale=0.2 / np.sqrt(3))),
    ],
    ids=["as-believed", "noisier", "biased", "student-t"],
)
def test_a_true_sensor_errs_by_its_law(true: TrueSensor, law):
    errors = noise(truth_of([PLACE()], Truth(sensors=[true])))[:, 0, 0]
    assert stats.kstest(errors, law.cdf).pvalue > 1e-4


def test_outliers_have_their_share_and_size():
    true = TrueSensor(outlier_share=0.1, outlier_scale=50)
    errors = noise(truth_of([PLACE()], Truth(sensors=[true])))[:, 0, 0] / 0.2
    far = np.abs(errors) > 5
    # Of the outliers, P(|50 n| > 5) = 0.92: 368 of 4,000, with a deviation of 18.
    assert abs(far.sum() - 368) < 73
    assert np.median(np.abs(errors[far])) == pytest.approx(50 * 0.74, rel=0.2)


def test_a_true_h_and_a_true_start_are_those_of_the_truth_alone():
    truth = truth_of(
        [PLACE()],
        Truth(mean=[3, 0], cov=[0, 0], sensors=[TrueSensor(h=lambda x: 2 * x[..., :1])]),
    )
    state, mean, cov = truth.initial(np.zeros(2))
    assert state.tolist() == [3, 0] and mean.tolist() == [0, 0]
    np.testing.assert_array_equal(cov, np.eye(2))
    assert truth.observe(np.array([3.0, 0.0]), np.zeros((1, 1, 1)), 0).item() == 6.0
    sensor = truth.sensor(0)
    assert sensor is not None and sensor.measure(np.array([3.0, 0.0]), 0).item() == 3.0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: PLACE(every_s=0.0), "every_s 0.0: must be above 0"),
        (lambda: PLACE(delay_s=-1.0), "delay_s -1.0: must be 0 or more"),
        (lambda: PLACE(missing=1.0), "missing 1.0: must be a probability"),
        (lambda: PLACE(channels=(("a", "m"), ("b", "m"))), "must have 1 pairs"),
        (lambda: truth_of([PLACE(every_s=0.01)]), "a sensor reads once in a step of 0.1 s"),
        (lambda: truth_of([[PLACE(gate=0.99), BOTH()]]), "a gate judges all that a node reads"),
        (lambda: truth_of([[PLACE(), "gps"]]), "entry 0 is of type str; it must be an OwnSensor"),
        (lambda: truth_of([PLACE()], Truth(sensors=[])), "sensors has 0 entries for 1 nodes"),
        (lambda: truth_of([PLACE()], wrong_truth()), "of type int; give a TrueSensor"),
        (lambda: truth_of([PLACE()], Truth(sensors=[TrueSensor(R=[1, 1])])), "the believed one 1"),
        (lambda: truth_of([PLACE()], Truth(sensors=[TrueSensor(bias=[1, 2])])), "one number, or 1"),
        (lambda: truth_of([PLACE()], Truth(sensors=[TrueSensor(h=lambda x: x)])), r"truth: h\(x\)"),
        (lambda: Truth(mean=[1], cov=[1], f=lambda x: x, Q=[1]).plant_of(PLANT), "it has 1 states"),
        (lambda: Truth(f=lambda x: x[0]).plant_of(PLANT), r"truth: f\(x\)"),
        (lambda: TrueSensor(degrees_of_freedom=2), "must be above 2"),
        (lambda: TrueSensor(outlier_share=1), "must be 0 or more, below 1"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make, says: str):
    with pytest.raises(ValueError, match=says):
        make()
