"""Closed loops on the truth: the sampled default controllers, and an unknown road."""

import numpy as np
import pytest

from concord.features.control import cruise, motor, suspension
from concord.features.control.closed_loop import Response, closed_loop, quiet, step_figures
from concord.features.control.controllers import StateFeedback
from concord.features.control.references import constant
from concord.plants.linear import LinearPlant


def run(plant: LinearPlant, controller, seconds: float) -> Response:
    steps = round(seconds / plant.time_step_s)
    return closed_loop(plant, controller, quiet(plant, steps))


def test_cruise_by_sampled_poles_is_as_fast():
    response = run(cruise.cruise(), cruise.cruise_controller(), 30)
    assert step_figures(response.states[:, 0], 0.01, 10).settling_time_s == pytest.approx(2.61)


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
