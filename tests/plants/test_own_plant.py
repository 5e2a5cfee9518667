"""A plant of the user's own: its statistics, its checks, and its agreement with a plant of ours."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from concord.plants.linear_systems import from_control
from concord.plants.own_plant import OwnPlant
from concord.plants.own_sensor import OwnSensor
from concord.plants.own_truth import OwnTruth, sensors_of_nodes

MATRIX = np.array([[1.0, 0.1], [-0.2, 0.9]])
LINEAR = OwnPlant(f=lambda x: x @ MATRIX.T, Q=[0.01, 0.04], mean=[1, 2], cov=[[2, 0.5], [0.5, 1]])
FIRST = OwnSensor(h=lambda x: x[..., :1], R=0.25)
BOTH = OwnSensor(h=lambda x: x, R=[[1.0, 0.6], [0.6, 1.0]])


def test_truth_and_readings_have_the_moments_that_were_given():
    truth = OwnTruth(LINEAR, sensors_of_nodes(LINEAR, [FIRST, BOTH, None]))
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((100_000, 2))
    state, mean, cov = truth.initial(noise)
    assert np.array_equal(cov, LINEAR.prior_cov) and np.array_equal(mean[0], [1, 2])
    # Sample covariances of 1e5 draws lie within 5 sd of sqrt(2 / 1e5) times the variances.
    assert np.cov(state.T) == pytest.approx(LINEAR.prior_cov, abs=5 * 2 * np.sqrt(2e-5))
    moved = truth.advance(np.zeros((100_000, 2)), None, noise, 0)
    assert np.cov(moved.T) == pytest.approx(LINEAR.noise_cov, abs=5 * 0.04 * np.sqrt(2e-5))
    readings = truth.observe(np.zeros((100_000, 2)), rng.standard_normal((100_000, 3, 1, 2)), 0)
    assert np.isnan(readings[:, 2]).all() and np.isnan(readings[:, 0, 0, 1]).all()
    assert np.var(readings[:, 0, 0, 0]) == pytest.approx(0.25, rel=5 * np.sqrt(2e-5))
    assert np.cov(readings[:, 1, 0].T) == pytest.approx(BOTH.noise_cov, abs=5 * np.sqrt(2e-5))


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_differences_of_angles_are_wrapped(a: float, b: float):
    compass = OwnSensor(h=lambda x: x[..., :1], R=0.1, angles=(0,))
    (wrapped,) = compass.residual(np.array([a]), np.array([b]))
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * (a - b)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"f": lambda x: np.stack((x[0], x[1]))}, "leading axes are free"),
        ({"f": lambda x: x / (1 + np.abs(x).max())}, "mixes the lanes"),
        ({"f": lambda x: x[..., :1]}, r"must be \(3, 2, 2\)"),
        ({"f": lambda x: x @ np.eye(3)}, "fails"),
        ({"Q": [1, 2, 3]}, r"Q of shape \(3,\): must be \(2, 2\)"),
        ({"Q": [[1, 2], [2, 1]]}, "Q: has a negative eigenvalue"),
        ({"cov": [[1, 2], [0, 1]]}, "cov: must be finite and symmetric"),
        ({"time_step_s": 0}, "time_step_s 0: must be above 0"),
        ({"state_names": ("x",)}, "state_names"),
        ({"mean": [0, np.nan]}, "mean"),
    ],
)
def test_a_plant_that_is_none_is_refused(change: dict, says: str):
    given_ = {"f": lambda x: x, "Q": [1, 1], "mean": [0, 0], "cov": [1, 1], **change}
    with pytest.raises(ValueError, match=says):
        OwnPlant(**given_)


def test_sensors_that_cannot_read_the_states_are_refused():
    with pytest.raises(ValueError, match="none of the nodes has one"):
        sensors_of_nodes(LINEAR, [None])
    with pytest.raises(ValueError, match="must be"):
        sensors_of_nodes(LINEAR, [OwnSensor(h=lambda x: x, R=1.0)])
    with pytest.raises(ValueError, match="angles"):
        OwnSensor(h=lambda x: x, R=1.0, angles=(1,))


def test_a_system_of_python_control_is_sampled():
    continuous = control.ss([[0, 1], [-1, -0.1]], [[0], [1]], [[1, 0]], [[0]])
    law = {"Q": [0.1, 0.1], "R": 1.0, "mean": [0, 0], "cov": [1, 1]}
    plant, sensor = from_control(continuous, time_step_s=0.1, **law)
    state = np.array([1.0, -2.0])
    expected = expm(np.array([[0, 1], [-1, -0.1]]) * 0.1) @ state
    assert plant.transition(state, None, 0) == pytest.approx(expected)
    assert sensor.h(state) == pytest.approx([1.0])
    with pytest.raises(ValueError, match="give time_step_s"):
        from_control(continuous, **law)
    sampled = control.c2d(continuous, 0.1)
    assert from_control(sampled, **law)[0].time_step_s == 0.1
    with pytest.raises(ValueError, match="leave it out"):
        from_control(sampled, time_step_s=0.2, **law)


# --- angles --------------------------------------------------------------------------------------


def turning(x: np.ndarray) -> np.ndarray:
    angle = x[..., 0] + 0.1 * x[..., 1]
    return np.stack(((angle + np.pi) % (2 * np.pi) - np.pi, x[..., 1]), axis=-1)


def heading(**fields) -> OwnPlant:
    given_ = {"f": turning, "Q": [1e-4, 1e-4], "mean": [0, 0.3], "cov": [0.05, 0.01], **fields}
    return OwnPlant(**given_)


@pytest.mark.parametrize("at", [0.0, 3.1, -3.1, 100.0])
def test_a_jump_by_a_turn_is_found_and_refused_with_its_cure(at: float):
    with pytest.raises(ValueError, match=r"f\(x\) jumps by 2 pi in state 0 .*angles=\(0,\)"):
        heading(mean=[at, 0.3])
    compass = OwnSensor(h=lambda x: turning(x)[..., :1], R=0.1)
    with pytest.raises(
        ValueError, match=r"h\(x\) jumps by 2 pi in entry 0 .*OwnSensor\(angles=\(0"
    ):
        sensors_of_nodes(heading(mean=[at, 0.3], angles=(0,)), [compass])


def test_what_steps_by_no_turn_or_is_steep_is_no_jump():
    heading(f=lambda x: np.floor(x) * 6.28)
    heading(f=lambda x: np.stack((1e4 * np.tanh(20 * x[..., 0]), x[..., 1]), axis=-1))
    heading(f=lambda x: np.where(x > 50, 1 / 0, x) if (x > 50).any() else x)


@pytest.mark.parametrize(
    ("angles", "says"),
    [((2,), "must be some of the states 0 to 1"), ((0, 0), "each once"), ((-1,), "states 0 to 1")],
)
def test_angles_that_are_none_are_refused(angles: tuple[int, ...], says: str):
    with pytest.raises(ValueError, match=says):
        heading(angles=angles)


def test_a_function_of_the_turn_is_refused_where_the_state_is_an_angle():
    with pytest.raises(ValueError, match=r"state 0 is just below pi.* take it out of angles"):
        heading(f=lambda x: 0.5 * x, angles=(0,))
    with pytest.raises(ValueError, match=r"use the sine and cosine"):
        sensors_of_nodes(heading(angles=(0,)), [OwnSensor(h=lambda x: 0.5 * x, R=[1, 1])])
    sensors_of_nodes(heading(angles=(0,)), [OwnSensor(h=lambda x: np.cos(x), R=[1, 1])])


@given(st.floats(-40, 40), st.floats(-300, 300))
def test_a_turning_state_goes_on_counting_turns(angle: float, rate: float):
    state = np.array([angle, rate])
    moved = heading(angles=(0,)).transition(state, None, 0)
    assert abs(moved[0] - angle) <= np.pi
    assert np.exp(1j * moved[0]) == pytest.approx(np.exp(1j * (angle + 0.1 * rate)))
    assert moved[1] == rate
