"""Classical controllers: their recursion against other simulations, limits and root loci."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from concord.features.control import cruise, motor, pitch
from concord.features.control.closed_loop import closed_loop, quiet
from concord.features.control.controllers import IntegralFeedback, OutputFeedback, StateFeedback
from concord.features.control.references import constant
from concord.features.control.transfer_functions import (
    Rational,
    lag,
    lead,
    output_feedback,
    pid,
    proportional,
    proportional_integral,
    root_locus,
    sampled_compensator,
    series,
)
from concord.papers.wac.loops import figure_7

TIME_STEP_S = 0.01


def commanded(controller: Rational, errors: np.ndarray) -> np.ndarray:
    """Controls (steps,) of the memory recursion when the error is errors (steps,)."""
    compensator = sampled_compensator(controller, TIME_STEP_S)
    feedback = OutputFeedback(compensator, np.array([[-1.0]]), constant(0.0))
    memory, controls = feedback.initial_memory, []
    for step, error in enumerate(errors):
        value, memory = feedback.control(np.array([error]), memory, step)
        controls.append(value[0])
    return np.array(controls)


@pytest.mark.parametrize("controller", [cruise.LAG, pitch.LEAD, motor.SPEED_LAG])
def test_lag_and_lead_equal_scipys_tustin_simulation(controller: Rational):
    errors = np.random.default_rng(2).standard_normal(200)
    system: Any = signal.lti(*controller)
    simulated = signal.dlsim(system.to_discrete(TIME_STEP_S, method="bilinear"), errors)
    assert commanded(controller, errors) == pytest.approx(simulated[1][:, 0], rel=1e-9, abs=1e-9)


def test_pid_equals_its_sums_and_differences():
    errors = np.random.default_rng(4).standard_normal(200)
    before = np.concatenate([[0.0], errors[:-1]])
    trapezoids = np.cumsum((errors + before) / 2) * TIME_STEP_S
    expected = 100 * errors + 200 * trapezoids + 10 * (errors - before) / TIME_STEP_S
    assert commanded(motor.SPEED_PID, errors) == pytest.approx(expected, rel=1e-9)


def test_controllers_are_equation_23():
    s = 0.3 + 2j
    assert proportional(3.0)(s) == pytest.approx(3)
    assert proportional_integral(3.0, 2.0)(s) == pytest.approx(3 + 2 / s)
    assert pid(3.0, 2.0, 5.0)(s) == pytest.approx(3 + 2 / s + 5 * s)
    assert lag(2.0, 0.3, 0.03)(0) == pytest.approx(20)
    assert lead(2.0, 0.9, 20.0)(1e9) == pytest.approx(2)
    assert series(lag(2.0, 0.3, 0.03), pid(3.0, 2.0, 5.0))(s) == pytest.approx(
        2 * (s + 0.3) / (s + 0.03) * (3 + 2 / s + 5 * s)
    )


@pytest.mark.parametrize(("make", "zero", "pole"), [(lag, 0.03, 0.3), (lead, 20.0, 0.9)])
def test_lag_and_lead_are_not_exchanged(make, zero: float, pole: float):
    with pytest.raises(ValueError, match=f"{make.__name__} compensator .* it needs 0 <= "):
        make(1.0, zero=zero, pole=pole)


def test_second_derivative_is_refused():
    with pytest.raises(ValueError, match="differentiates twice"):
        sampled_compensator(Rational((1.0, 0.0, 0.0), (1.0,)), TIME_STEP_S)


@pytest.mark.parametrize("name", ["POSITION_PROPORTIONAL", "POSITION_PROPORTIONAL_INTEGRAL"])
def test_position_loops_of_this_project_arrive(name: str):
    feedback = output_feedback(
        motor.position_dynamics(), TIME_STEP_S, getattr(motor, name), constant(1.0)
    )
    plant = motor.motor_position()
    states = closed_loop(plant, feedback, quiet(plant, 8000)).states
    assert states[-1, 0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("panel", figure_7().values(), ids=figure_7().keys())
def test_root_loci_solve_the_characteristic_equation(panel):
    poles = panel.poles()
    assert poles.shape == (len(panel.gains), len(panel.loop.denominator) - 1)
    for gain, row in zip(panel.gains[::50], poles[::50], strict=True):
        polynomial = np.polyadd(panel.loop.denominator, gain * np.array(panel.loop.numerator))
        size = np.polyval(np.abs(polynomial), np.abs(row))
        assert np.all(np.abs(np.polyval(polynomial, row)) <= 1e-6 * size)
        # The sum of the poles is the polynomial's: no root counted twice, none missed.
        assert row.sum() == pytest.approx(-polynomial[1] / polynomial[0], rel=1e-6)


def test_root_loci_start_at_the_poles_and_end_at_the_zeros():
    panel = figure_7()["h"]
    open_loop = np.concatenate([[-20], np.roots(pitch.transfer_function().denominator)])
    assert np.sort_complex(panel.poles()[0]) == pytest.approx(np.sort_complex(open_loop), abs=1e-6)
    far = root_locus(panel.loop, np.array([0.0, 1e7]))[-1]
    for zero in (-0.9, -0.17742 / 1.15101):
        assert np.abs(far - zero).min() < 1e-3


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 1e3), st.integers(0, 2**31))
def test_controls_are_those_of_each_lane_and_keep_the_limit(limit: float, seed: int):
    generator = np.random.default_rng(seed)
    states = 10 * generator.standard_normal((5, 2, 3))
    gain, row = generator.standard_normal((1, 3)) * 1e3, np.eye(3)[:1]
    compensator = sampled_compensator(pid(100.0, 200.0, 10.0), TIME_STEP_S)
    one = constant(1.0)
    free = StateFeedback(gain, np.ones((1, 1)), one)
    limited = StateFeedback(gain, np.ones((1, 1)), one, limit)
    wanted, value = (some.control(states, some.initial_memory, 0)[0] for some in (free, limited))
    assert np.array_equal(value, np.clip(wanted, -limit, limit))
    for controller in (
        limited,
        IntegralFeedback(gain, np.ones((1, 1)), row, TIME_STEP_S, one),
        OutputFeedback(compensator, row, one),
    ):
        value, memory = controller.control(states, controller.initial_memory, 0)
        assert value.shape == (5, 2, 1)
        for index in np.ndindex(5, 2):
            alone, remembered = controller.control(states[index], controller.initial_memory, 0)
            assert alone == pytest.approx(value[index])
            assert remembered == pytest.approx(
                np.broadcast_to(memory, (5, 2, memory.shape[-1]))[index]
            )


def test_integral_memory_is_the_sum_of_the_error():
    controller = IntegralFeedback(
        np.zeros((1, 2)), np.array([[4.0]]), np.eye(2)[:1], 0.5, constant(2.0)
    )
    memory = controller.initial_memory
    first, memory = controller.control(np.array([5.0, 0.0]), memory, 0)
    second, memory = controller.control(np.array([1.0, 9.0]), memory, 1)
    assert (first[0], second[0]) == (0.0, -4.0 * 0.5 * 3.0)
    assert memory == pytest.approx([0.5 * (3.0 - 1.0)])
