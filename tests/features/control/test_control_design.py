"""Gains against other ways to compute them, and gains that are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_are

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.design import (
    continuous_gain_feedback,
    lqr_gain,
    placed_feedback,
    pole_placement,
    precompensation,
    refuse_unstable,
)
from concord.features.control.references import constant

STEP = constant(1.0)


@pytest.mark.parametrize(
    ("weight", "gain"),
    [(50.0, [-0.643457, 169.695, 7.07107]), (2.0, [-0.5034, 52.865, 1.4142])],
)
def test_pitch_lqr(weight: float, gain: list[float]):
    plant = pitch.dynamics()
    found = lqr_gain(plant, weight)
    assert found[0] == pytest.approx(gain, rel=1e-4)
    cost = weight * plant.output_row.T @ plant.output_row
    riccati = solve_continuous_are(plant.state_matrix, plant.control_matrix, cost, np.eye(1))
    assert found == pytest.approx(plant.control_matrix.T @ riccati, rel=1e-7)
    assert continuous_gain_feedback(plant, 0.01, found, STEP).precompensation == pytest.approx(
        np.sqrt(weight)
    )


def test_position_gain_of_the_paper_is_refused_at_10_ms():
    plant = motor.position_dynamics()
    gain = pole_placement(plant.state_matrix, plant.control_matrix, motor.PAPER_POSITION_POLES)
    message = r"dc-motor-position: .* 0\.01 s: largest \|z\| = 4\.77, .* below 1; place the sampled"
    with pytest.raises(ValueError, match=message):
        continuous_gain_feedback(plant, 0.01, gain, STEP)
    continuous_gain_feedback(plant, 0.005, gain, STEP)
    with pytest.raises(ValueError, match="largest"):
        continuous_gain_feedback(plant, 0.0055, gain, STEP)


@pytest.mark.parametrize(
    ("plant", "poles", "time_step_s"),
    [
        (cruise.dynamics(), cruise.POLES, 0.01),
        (motor.speed_dynamics(), motor.SPEED_POLES, 0.01),
        (motor.position_dynamics(), motor.POSITION_POLES, 0.01),
        (motor.position_dynamics(), motor.PAPER_POSITION_POLES, 0.01),
    ],
    ids=["cruise", "speed", "position", "position, the paper's poles"],
)
def test_sampled_poles_are_exp_of_the_wanted_ones(plant, poles, time_step_s):
    gain = placed_feedback(plant, time_step_s, poles, STEP).gain
    transition, control_matrix = plant.sampled(time_step_s)
    found = np.linalg.eigvals(transition - control_matrix @ gain)
    wanted = np.exp(np.array(poles) * time_step_s)
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(wanted), rel=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 4), st.integers(0, 2**31))
def test_precompensation_brings_the_output_to_the_reference(n: int, seed: int):
    generator = np.random.default_rng(seed)
    transition = np.eye(n) + 0.1 * generator.standard_normal((n, n))
    control_matrix = generator.standard_normal((n, 1))
    output_row = generator.standard_normal((1, n))
    poles = generator.uniform(0.1, 0.8, n).tolist()
    gain = pole_placement(transition, control_matrix, poles)
    closed = transition - control_matrix @ gain
    forward = precompensation(transition, control_matrix, output_row, gain)
    resting = np.linalg.solve(np.eye(n) - closed, control_matrix @ forward)
    assert output_row @ resting == pytest.approx(np.ones((1, 1)), rel=1e-5)


def test_two_controls_hold_two_outputs():
    generator = np.random.default_rng(5)
    transition = 0.3 * generator.standard_normal((3, 3))
    control_matrix = generator.standard_normal((3, 2))
    output_rows = generator.standard_normal((2, 3))
    gain = 0.1 * generator.standard_normal((2, 3))
    forward = precompensation(transition, control_matrix, output_rows, gain)
    closed = transition - control_matrix @ gain
    resting = output_rows @ np.linalg.solve(np.eye(3) - closed, control_matrix @ forward)
    assert resting == pytest.approx(np.eye(2))


def test_without_its_integrator_the_bus_has_one():
    plant = suspension.dynamics()
    transition, control_matrix = plant.sampled(suspension.TIME_STEP_S)
    forward = precompensation(transition, control_matrix, plant.output_row, np.zeros((1, 4)))
    assert forward == pytest.approx(suspension.K1, rel=1e-6)  # the spring alone resists at rest


def test_number_of_poles_is_checked():
    plant = motor.speed_dynamics()
    with pytest.raises(ValueError, match="1 poles for 2 states"):
        pole_placement(plant.state_matrix, plant.control_matrix, [-1.0])


def test_stable_gain_is_not_refused_and_the_bound_is_the_circle():
    refuse_unstable("x", np.array([[0.999]]), np.array([[1.0]]), np.zeros((1, 1)), 0.01)
    with pytest.raises(ValueError, match=r"largest \|z\| = 1\.00"):
        refuse_unstable("x", np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1)), 0.01)


def test_output_that_a_constant_control_cannot_move_is_refused():
    # C (I - F)^-1 G = 1.25 / .5 - 2 / .8 = 0: a zero at z = 1 without an integrator.
    transition, control_matrix = np.diag([0.5, 0.2]), np.ones((2, 1))
    with pytest.raises(ValueError, match=r"of size 3 is singular"):
        precompensation(transition, control_matrix, np.array([[1.25, -2.0]]), np.zeros((1, 2)))
