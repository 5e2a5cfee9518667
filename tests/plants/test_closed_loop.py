"""Closed loops against the figures of the specification, to the digits printed there."""

import numpy as np
import pytest

from plants.control import cruise, motor, pitch, suspension
from plants.control.closed_loop import Response, closed_loop, quiet, step_figures
from plants.control.controllers import StateFeedback
from plants.control.design import (
    continuous_gain_feedback,
    lqr_gain,
    placed_feedback,
    pole_placement,
)
from plants.control.references import constant
from plants.linear import LinearPlant


def run(plant: LinearPlant, controller, seconds: float) -> Response:
    steps = round(seconds / plant.time_step_s)
    return closed_loop(plant, controller, quiet(plant, steps))


def last_time(time_step_s: float, outside: np.ndarray) -> float:
    """End of the last sample at which the condition holds."""
    return time_step_s * (np.flatnonzero(outside)[-1] + 1)


def paper_cruise(limit: float = np.inf) -> StateFeedback:
    plant = cruise.dynamics()
    gain = pole_placement(plant.state_matrix, plant.control_matrix, cruise.POLES)
    return continuous_gain_feedback(plant, 0.01, gain, cruise.REFERENCE, limit)


def test_cruise_follows_both_speeds():
    response = run(cruise.cruise(), paper_cruise(), 50)
    speed = response.states[:, 0]
    first = step_figures(speed[:3000], 0.01, 10)
    second = step_figures(10 - speed[3000:], 0.01, 3)
    assert first.settling_time_s == pytest.approx(2.59)
    assert second.settling_time_s == pytest.approx(2.59)
    assert (first.overshoot_percent, second.overshoot_percent) == pytest.approx((0, 0), abs=1e-9)
    assert response.controls[0, 0] == pytest.approx(15_000)
    assert np.array_equal(np.unique(response.references), [7, 10])


def test_cruise_by_sampled_poles_is_as_fast():
    response = run(cruise.cruise(), cruise.cruise_controller(), 30)
    assert step_figures(response.states[:, 0], 0.01, 10).settling_time_s == pytest.approx(2.61)


def test_cruise_with_500_newton_never_arrives():
    response = run(cruise.cruise(), paper_cruise(500.0), 30)
    assert np.abs(response.controls).max() == 500
    assert response.states[-1, 0] == pytest.approx(7.77, abs=5e-3)
    assert response.states.max() < 10
    # With the limit held, the speed is that of the free car: 10 (1 - exp(-t / 20 s)).
    assert response.states[-1, 0] == pytest.approx(10 * (1 - np.exp(-29.99 / 20)), rel=1e-9)


def test_bus_takes_the_road_step():
    plant = suspension.suspension(road=suspension.ROAD_STEP)
    response = run(plant, suspension.suspension_controller(), 10)
    travel, body = np.abs(response.states[:, 2]), response.states[:, 0]
    step_s = plant.time_step_s
    assert 1e3 * travel.max() == pytest.approx(4.82, abs=5e-3)
    assert last_time(step_s, travel >= 2e-3) == pytest.approx(0.36, abs=5e-3)
    assert last_time(step_s, travel >= 0.02 * travel.max()) == pytest.approx(1.36, abs=5e-3)
    assert last_time(step_s, np.abs(body - 0.1) > 0.005) == pytest.approx(1.0, abs=0.05)
    assert np.abs(response.controls).max() == pytest.approx(1.5e6, rel=0.03)


def test_bus_without_control_sways_for_25_seconds():
    plant = suspension.suspension(road=suspension.ROAD_STEP)
    idle = StateFeedback(np.zeros((1, 4)), np.zeros((1, 1)), constant(0.0))
    travel = np.abs(run(plant, idle, 30).states[:, 2])
    assert last_time(plant.time_step_s, travel >= 5e-3) == pytest.approx(25.8, abs=0.05)


def test_unknown_road_moves_the_truth_alike_and_leaves_the_model_alone():
    known = suspension.suspension(road=suspension.ROAD_STEP)
    unknown = suspension.suspension(road=suspension.ROAD_STEP, road_known=False)
    state = np.array([0.01, 0.2, -0.01, 0.5])
    noise = np.array([0.3, -1.2])
    assert known.advance(state, None, noise, 0) == pytest.approx(
        unknown.advance(state, None, noise, 0), rel=1e-14
    )
    believed = known.model.transition(state, None, 0) - unknown.model.transition(state, None, 0)
    travel_jump = -suspension.B2 / suspension.M2 * 0.1 * known.time_step_s
    assert believed[2] == pytest.approx(travel_jump, rel=0.02)


@pytest.mark.parametrize(("reference", "deflection"), [(0.2, 1.41), (0.5, 3.54)])
def test_pitch_follows_the_lqr(reference: float, deflection: float):
    designed = pitch.pitch_controller()
    controller = StateFeedback(designed.gain, designed.precompensation, constant(reference))
    response = run(pitch.pitch(), controller, 7)
    figures = step_figures(response.states[:, 2], 0.01, reference)
    assert figures.rise_time_s == pytest.approx(0.72)
    assert figures.settling_time_s == pytest.approx(2.01)
    assert figures.overshoot_percent == pytest.approx(5.0, abs=0.05)
    assert np.abs(response.controls).max() == pytest.approx(deflection, abs=5e-3)


def test_pitch_with_a_small_weight_is_not_settled_after_7_seconds():
    plant = pitch.dynamics()
    controller = continuous_gain_feedback(plant, 0.01, lqr_gain(plant, 2.0), constant(0.2))
    response = run(pitch.pitch(), controller, 20)
    assert step_figures(response.states[:, 2], 0.01, 0.2).settling_time_s > 7


def test_speed_of_the_motor():
    plant = motor.speed_dynamics()
    gain = pole_placement(plant.state_matrix, plant.control_matrix, motor.SPEED_POLES)
    controller = continuous_gain_feedback(plant, 0.01, gain, constant(1.0))
    response = run(motor.motor_speed(), controller, 10)
    figures = step_figures(response.states[:, 0], 0.01, 1)
    assert figures.settling_time_s == pytest.approx(1.09)
    assert figures.overshoot_percent == pytest.approx(0, abs=5e-3)
    assert response.controls[0, 0] == pytest.approx(13)
    assert response.controls[-1, 0] == pytest.approx(10.01)


@pytest.mark.parametrize(
    ("poles", "settling", "overshoot", "volt"),
    [
        pytest.param(motor.PAPER_POSITION_POLES, 0.05, 2.5, 338_554, id="paper"),
        pytest.param(motor.POSITION_POLES, 1.18, 0.0, 182.857, id="default"),
    ],
)
def test_position_of_the_motor(poles, settling: float, overshoot: float, volt: float):
    controller = placed_feedback(motor.position_dynamics(), 0.01, poles, constant(1.0))
    response = run(motor.motor_position(), controller, 10)
    figures = step_figures(response.states[:, 0], 0.01, 1)
    assert figures.settling_time_s == pytest.approx(settling)
    assert figures.overshoot_percent == pytest.approx(overshoot, abs=0.05)
    assert response.controls[0, 0] == pytest.approx(volt, rel=1e-5)


def test_loop_is_closed_on_the_truth_with_noise():
    # The closed loop is linear: its covariance settles where the Lyapunov equation says.
    from scipy.linalg import solve_discrete_lyapunov

    plant = motor.motor_speed()
    designed = motor.motor_speed_controller()
    controller = StateFeedback(designed.gain, designed.precompensation, constant(0.0))
    generator = np.random.default_rng(8)
    draws = quiet(plant, 40_000)._replace(process=generator.standard_normal((40_000, 2)))
    states = closed_loop(plant, controller, draws).states[500:]
    closed = plant.model.transition_matrix - plant.model.control_matrix @ controller.gain
    expected = solve_discrete_lyapunov(closed, plant.model.noise_cov)
    # Poles of |z| = .95 leave about 40 000 / 40 independent samples: a standard error of 4.5 %.
    assert states.var(axis=0) == pytest.approx(np.diag(expected), rel=0.2)
