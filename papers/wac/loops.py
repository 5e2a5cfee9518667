"""The closed loops of the consensus paper, measured.

Loops run digitally from the true state and without noise; the control is held over each sampling
time. Lead and lag also run in continuous time, where the specification gives their overshoot.
"""

from typing import NamedTuple

import numpy as np

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.closed_loop import (
    Controller,
    Response,
    StepFigures,
    closed_loop,
    quiet,
    step_figures,
)
from concord.features.control.controllers import StateFeedback
from concord.features.control.design import (
    continuous_gain_feedback,
    lqr_gain,
    placed_feedback,
    pole_placement,
)
from concord.features.control.references import constant
from concord.features.control.transfer_functions import Rational, output_feedback, series
from concord.plants.linear import LinearPlant


class Loops(NamedTuple):
    """Measured values. Times in s, angles in rad; `_n`, `_v` are controls in newton and volt."""

    cruise_gain: float
    cruise_precompensation: float
    cruise_first: StepFigures
    cruise_second: StepFigures
    cruise_start_n: float
    cruise_limited_speed: float
    cruise_limited_peak: float
    cruise_proportional_rest: float
    cruise_lag_rest: float
    cruise_lag_settling_s: float
    bus_poles: np.ndarray
    bus_peak_m: float
    bus_below_2_mm_s: float
    bus_settling_s: float
    bus_body_settling_s: float
    bus_force_n: float
    bus_open_beyond_5_mm_s: float
    bus_pid_peak_m: float
    bus_pid_within_5_mm_s: float
    pitch_gain: np.ndarray
    pitch_precompensation: float
    pitch_poles: np.ndarray
    pitch_steps: tuple[StepFigures, StepFigures]
    pitch_deflections_rad: tuple[float, float]
    pitch_soft_gain: np.ndarray
    pitch_soft_settling_s: float
    pitch_lead: StepFigures
    speed_gain: np.ndarray
    speed_sampled_gain: np.ndarray
    speed_precompensation: float
    speed_step: StepFigures
    speed_start_v: float
    speed_rest_v: float
    speed_pid_settling_s: float
    speed_lag: StepFigures
    position_gain: np.ndarray
    position_largest_pole: float
    position_largest_pole_5_ms: float
    position_sampled_gain: np.ndarray
    position_fast: StepFigures
    position_fast_volt: float
    position_default_gain: np.ndarray
    position_default: StepFigures


def measure() -> Loops:
    """Run every loop."""
    return Loops(**_cruise(), **_bus(), **_pitch(), **_speed(), **_position())


def road_step_response(seconds: float, controller: Controller) -> Response:
    """The bus over the road's step of 0.1 m, without noise."""
    return _run(suspension.suspension(road=suspension.ROAD_STEP), controller, seconds)


def idle(states: int) -> StateFeedback:
    """No control at all."""
    return StateFeedback(np.zeros((1, states)), np.zeros((1, 1)), constant(0.0))


def position_gain_of_the_paper() -> np.ndarray:
    """K (1, 3) for the printed poles -100 +- 100i and -200, designed in continuous time."""
    plant = motor.position_dynamics()
    return pole_placement(plant.state_matrix, plant.control_matrix, motor.PAPER_POSITION_POLES)


# --- measuring -----------------------------------------------------------------------------------


def _run(plant: LinearPlant, controller: Controller, seconds: float) -> Response:
    steps = round(seconds / plant.time_step_s)
    return closed_loop(plant, controller, quiet(plant, steps))


def _end_of(outside: np.ndarray, time_step_s: float) -> float:
    """The time after the last sample at which a condition holds; 0 if it never does."""
    return time_step_s * (np.flatnonzero(outside)[-1] + 1) if outside.any() else 0.0


def _continuous_step(controller: Rational, plant: Rational) -> StepFigures:
    """The unit step of a classical loop in continuous time: sampling adds to its overshoot."""
    import control

    loop = control.feedback(control.tf(*series(controller, plant)), 1)
    times = np.linspace(0, 60, 60_001)
    output = np.asarray(control.step_response(loop, times).outputs)
    return step_figures(output, times[1], output[-1])


def _cruise() -> dict:
    plant, car = cruise.dynamics(), cruise.cruise()
    gain = pole_placement(plant.state_matrix, plant.control_matrix, cruise.POLES)

    def feedback(limit: float) -> StateFeedback:
        step_s = cruise.TIME_STEP_S
        return continuous_gain_feedback(plant, step_s, gain, cruise.REFERENCE, limit)

    free, limited = feedback(np.inf), feedback(500.0)
    response = _run(car, free, 50)
    speed = response.states[:, 0]
    slow = _run(car, limited, 30).states[:, 0]
    proportional = cruise.PROPORTIONAL(0) * cruise.transfer_function()(0)
    lagged = cruise.LAG(0) * cruise.transfer_function()(0)
    lag = output_feedback(plant, cruise.TIME_STEP_S, cruise.LAG, constant(1.0))
    output = _run(car, lag, 60).states[:, 0]
    return {
        "cruise_gain": gain[0, 0],
        "cruise_precompensation": free.precompensation[0, 0],
        "cruise_first": step_figures(speed[:3000], 0.01, 10),
        "cruise_second": step_figures(10 - speed[3000:], 0.01, 3),
        "cruise_start_n": response.controls[0, 0],
        "cruise_limited_speed": slow[-1],
        "cruise_limited_peak": slow.max(),
        "cruise_proportional_rest": float(proportional / (1 + proportional)),
        "cruise_lag_rest": float(lagged / (1 + lagged)),
        "cruise_lag_settling_s": step_figures(output, 0.01, output[-1]).settling_time_s,
    }


def _bus() -> dict:
    plant = suspension.dynamics()
    step_s = suspension.TIME_STEP_S
    state = np.block([[plant.state_matrix, np.zeros((4, 1))], [plant.output_row, np.zeros((1, 1))]])
    gain = np.append(suspension.GAIN, suspension.INTEGRAL_GAIN, axis=1)
    closed = state - np.append(plant.control_matrix, [[0.0]], axis=0) @ gain
    response = road_step_response(10, suspension.suspension_controller())
    travel, body = np.abs(response.states[:, 2]), response.states[:, 0]
    free = np.abs(road_step_response(30, idle(4)).states[:, 2])
    pid = output_feedback(plant, step_s, suspension.PID, constant(0.0))
    held = np.abs(road_step_response(2, pid).states[:, 2])
    return {
        "bus_poles": np.sort_complex(np.linalg.eigvals(closed)),
        "bus_peak_m": travel.max(),
        "bus_below_2_mm_s": _end_of(travel >= 2e-3, step_s),
        "bus_settling_s": _end_of(travel >= 0.02 * travel.max(), step_s),
        "bus_body_settling_s": _end_of(np.abs(body - 0.1) > 0.005, step_s),
        "bus_force_n": np.abs(response.controls).max(),
        "bus_open_beyond_5_mm_s": _end_of(free >= 5e-3, step_s),
        "bus_pid_peak_m": held.max(),
        "bus_pid_within_5_mm_s": _end_of(held > 5e-3, step_s),
    }


def _pitch() -> dict:
    plant, aircraft = pitch.dynamics(), pitch.pitch()
    designed = pitch.pitch_controller()

    def step_to(gain: np.ndarray, reference: float, seconds: float) -> tuple[StepFigures, float]:
        controller = continuous_gain_feedback(plant, 0.01, gain, constant(reference))
        response = _run(aircraft, controller, seconds)
        deflection = float(np.abs(response.controls).max())
        return step_figures(response.states[:, 2], 0.01, reference), deflection

    small, large = step_to(designed.gain, 0.2, 7), step_to(designed.gain, 0.5, 7)
    soft = lqr_gain(plant, 2.0)
    return {
        "pitch_gain": designed.gain[0],
        "pitch_precompensation": designed.precompensation[0, 0],
        "pitch_poles": np.sort_complex(
            np.linalg.eigvals(plant.state_matrix - plant.control_matrix @ designed.gain)
        ),
        "pitch_steps": (small[0], large[0]),
        "pitch_deflections_rad": (small[1], large[1]),
        "pitch_soft_gain": soft[0],
        "pitch_soft_settling_s": step_to(soft, 0.2, 20)[0].settling_time_s,
        "pitch_lead": _continuous_step(pitch.LEAD, pitch.transfer_function()),
    }


def _speed() -> dict:
    plant, rotor = motor.speed_dynamics(), motor.motor_speed()
    step_s = motor.TIME_STEP_S
    gain = pole_placement(plant.state_matrix, plant.control_matrix, motor.SPEED_POLES)
    controller = continuous_gain_feedback(plant, step_s, gain, constant(1.0))
    response = _run(rotor, controller, 10)

    pid = output_feedback(plant, step_s, motor.SPEED_PID, constant(1.0))
    fast = _run(rotor, pid, 60).states[:, 0]
    placed = placed_feedback(plant, step_s, motor.SPEED_POLES, constant(1.0))
    return {
        "speed_gain": gain[0],
        "speed_sampled_gain": placed.gain[0],
        "speed_precompensation": controller.precompensation[0, 0],
        "speed_step": step_figures(response.states[:, 0], step_s, 1),
        "speed_start_v": response.controls[0, 0],
        "speed_rest_v": response.controls[-1, 0],
        "speed_pid_settling_s": step_figures(fast, step_s, fast[-1]).settling_time_s,
        "speed_lag": _continuous_step(motor.SPEED_LAG, motor.speed_transfer_function()),
    }


def _position() -> dict:
    plant, rotor = motor.position_dynamics(), motor.motor_position()
    gain = position_gain_of_the_paper()

    def largest_pole(step_s: float) -> float:
        transition, control_matrix = plant.sampled(step_s)
        return float(np.abs(np.linalg.eigvals(transition - control_matrix @ gain)).max())

    def placed(poles) -> tuple[StateFeedback, StepFigures, float]:
        controller = placed_feedback(plant, motor.TIME_STEP_S, poles, constant(1.0))
        response = _run(rotor, controller, 10)
        figures = step_figures(response.states[:, 0], motor.TIME_STEP_S, 1)
        return controller, figures, float(np.abs(response.controls).max())

    fast, fast_figures, volt = placed(motor.PAPER_POSITION_POLES)
    _, default_figures, _ = placed(motor.POSITION_POLES)
    default = pole_placement(plant.state_matrix, plant.control_matrix, motor.POSITION_POLES)
    return {
        "position_gain": gain[0],
        "position_largest_pole": largest_pole(motor.TIME_STEP_S),
        "position_largest_pole_5_ms": largest_pole(0.005),
        "position_sampled_gain": fast.gain[0],
        "position_fast": fast_figures,
        "position_fast_volt": volt,
        "position_default_gain": default[0],
        "position_default": default_figures,
    }
