"""The closed loops of the consensus paper, measured, and their checks against the specification.

Loops run digitally from the true state and without noise; the control is held over each sampling
time. Lead and lag also run in continuous time, where the specification gives their overshoot.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace

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
    precompensation,
)
from concord.features.control.references import constant
from concord.features.control.transfer_functions import (
    Rational,
    output_feedback,
    root_locus,
    series,
)
from concord.papers.kit.judging import (
    Check,
    NamedFigures,
    above,
    at_most,
    below,
    checks_from,
    near,
    refused,
)
from concord.plants.linear import LinearPlant


def measure() -> NamedFigures:
    """Run every loop. Times in s, angles in rad; the suffixes `_kn`, `_mn`, `_mm`, `_v`, `_kv` of
    other figures are their units."""
    return {**_cruise(), **_bus(), **_pitch(), **_speed(), **_position()}


def _run(plant: LinearPlant, controller: Controller, seconds: float) -> Response:
    return closed_loop(plant, controller, quiet(plant, round(seconds / plant.time_step_s)))


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


def _cruise() -> NamedFigures:
    plant, car = cruise.dynamics(), cruise.cruise()
    gain = pole_placement(plant.state_matrix, plant.control_matrix, cruise.POLES)
    free, limited = (
        continuous_gain_feedback(plant, cruise.TIME_STEP_S, gain, cruise.REFERENCE, limit)
        for limit in (np.inf, 500.0)
    )
    response = _run(car, free, 50)
    speed = response.states[:, 0]
    slow = _run(car, limited, 30).states[:, 0]
    at_rest = cruise.transfer_function()(0)
    proportional, lagged = cruise.PROPORTIONAL(0) * at_rest, cruise.LAG(0) * at_rest
    lag = output_feedback(plant, cruise.TIME_STEP_S, cruise.LAG, constant(1.0))
    output = _run(car, lag, 60).states[:, 0]
    return {
        "cruise_gain": gain[0, 0],
        "cruise_precompensation": free.precompensation[0, 0],
        "cruise_first": step_figures(speed[:3000], 0.01, 10),
        "cruise_second": step_figures(10 - speed[3000:], 0.01, 3),
        "cruise_start_kn": response.controls[0, 0] / 1e3,
        "cruise_limited_speed": slow[-1],
        "cruise_limited_peak": slow.max(),
        "cruise_proportional_rest": float(proportional / (1 + proportional)),
        "cruise_lag_rest": float(lagged / (1 + lagged)),
        "cruise_lag": step_figures(output, 0.01, output[-1]),
    }


def _bus() -> NamedFigures:
    plant = suspension.dynamics()
    step_s = suspension.TIME_STEP_S
    stepped = suspension.suspension(road=suspension.ROAD_STEP)
    state = np.block([[plant.state_matrix, np.zeros((4, 1))], [plant.output_row, np.zeros((1, 1))]])
    gain = np.append(suspension.GAIN, suspension.INTEGRAL_GAIN, axis=1)
    closed = state - np.append(plant.control_matrix, [[0.0]], axis=0) @ gain
    poles = np.sort_complex(np.linalg.eigvals(closed))
    response = _run(stepped, suspension.suspension_controller(), 10)
    travel, body = np.abs(response.states[:, 2]), response.states[:, 0]
    idle = StateFeedback(np.zeros((1, 4)), np.zeros((1, 1)), constant(0.0))
    free = np.abs(_run(stepped, idle, 30).states[:, 2])
    pid = output_feedback(plant, step_s, suspension.PID, constant(0.0))
    held = np.abs(_run(stepped, pid, 2).states[:, 2])
    return {
        "bus_fast_pole": poles[1],
        "bus_middle_pole": poles[3],
        "bus_slow_pole": poles[4],
        "bus_peak_mm": 1e3 * travel.max(),
        "bus_below_2_mm_s": _end_of(travel >= 2e-3, step_s),
        "bus_settling_s": _end_of(travel >= 0.02 * travel.max(), step_s),
        "bus_body_settling_s": _end_of(np.abs(body - 0.1) > 0.005, step_s),
        "bus_force_mn": np.abs(response.controls).max() / 1e6,
        "bus_open_beyond_5_mm_s": _end_of(free >= 5e-3, step_s),
        "bus_pid_peak_mm": 1e3 * held.max(),
        "bus_pid_within_5_mm_s": _end_of(held > 5e-3, step_s),
    }


def _pitch() -> NamedFigures:
    plant, aircraft = pitch.dynamics(), pitch.pitch()
    designed = pitch.pitch_controller()

    def step_to(gain: np.ndarray, reference: float, seconds: float) -> tuple[StepFigures, float]:
        controller = continuous_gain_feedback(plant, 0.01, gain, constant(reference))
        response = _run(aircraft, controller, seconds)
        deflection = float(np.abs(response.controls).max())
        return step_figures(response.states[:, 2], 0.01, reference), deflection

    small, large = step_to(designed.gain, 0.2, 7), step_to(designed.gain, 0.5, 7)
    soft = lqr_gain(plant, 2.0)
    closed = plant.state_matrix - plant.control_matrix @ designed.gain
    poles = np.sort_complex(np.linalg.eigvals(closed))
    return {
        "pitch_gain": designed.gain[0],
        "pitch_precompensation": designed.precompensation[0, 0],
        "pitch_fast_pole": poles[1],
        "pitch_slow_pole": poles[2],
        "pitch_small": small[0],
        "pitch_small_elevator": small[1],
        "pitch_large": large[0],
        "pitch_large_elevator": large[1],
        "pitch_soft_gain": soft[0],
        "pitch_soft": step_to(soft, 0.2, 20)[0],
        "pitch_lead": _continuous_step(pitch.LEAD, pitch.transfer_function()),
    }


def _speed() -> NamedFigures:
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
        "speed_pid": step_figures(fast, step_s, fast[-1]),
        "speed_lag": _continuous_step(motor.SPEED_LAG, motor.speed_transfer_function()),
    }


def _position() -> NamedFigures:
    plant, rotor = motor.position_dynamics(), motor.motor_position()
    # For the printed poles -100 +- 100i and -200, designed in continuous time.
    gain = pole_placement(plant.state_matrix, plant.control_matrix, motor.PAPER_POSITION_POLES)

    def largest_pole(step_s: float) -> float:
        transition, control_matrix = plant.sampled(step_s)
        return float(np.abs(np.linalg.eigvals(transition - control_matrix @ gain)).max())

    def placed(poles) -> tuple[StateFeedback, StepFigures, float]:
        controller = placed_feedback(plant, motor.TIME_STEP_S, poles, constant(1.0))
        response = _run(rotor, controller, 10)
        figures = step_figures(response.states[:, 0], motor.TIME_STEP_S, 1)
        return controller, figures, float(np.abs(response.controls).max())

    fast, fast_figures, volt = placed(motor.PAPER_POSITION_POLES)
    default = pole_placement(plant.state_matrix, plant.control_matrix, motor.POSITION_POLES)
    return {
        "position_gain": gain[0],
        "position_largest_pole": largest_pole(motor.TIME_STEP_S),
        "position_largest_pole_5_ms": largest_pole(0.005),
        "position_sampled_gain": fast.gain[0],
        "position_fast": fast_figures,
        "position_fast_kv": volt / 1e3,
        "position_default_gain": default[0],
        "position_default": placed(motor.POSITION_POLES)[1],
    }


# --- the specification's figures, each to the digits printed there -------------------------------


def _entries(name: str, measured: np.ndarray, *printed: str) -> Iterator[Check]:
    """Each entry of a gain, to half a unit of the last digit printed."""
    for place, (entry, digits) in enumerate(zip(measured, printed, strict=True), start=1):
        decimals = len(digits.partition(".")[2])
        yield near(f"{name}[{place}]", entry, float(digits), 0.5 * 10.0**-decimals)


def _precompensation_with_integrator(_: SimpleNamespace) -> None:
    plant = suspension.dynamics()
    transition, control_matrix = plant.sampled(suspension.TIME_STEP_S)
    row = suspension.TIME_STEP_S * plant.output_row
    summed = np.block([[transition, np.zeros((4, 1))], [row, np.ones((1, 1))]])
    control = np.append(control_matrix, [[0.0]], axis=0)
    precompensation(summed, control, np.append(plant.output_row, [[0.0]], axis=1), np.zeros((1, 5)))


def _hold_the_papers_gain(at: SimpleNamespace) -> None:
    plant, gain = motor.position_dynamics(), at.position_gain[None]
    continuous_gain_feedback(plant, motor.TIME_STEP_S, gain, constant(1.0))


CHECKS = (
    (near, "cruise: gain K", "cruise_gain", 1450, 0.5, "N s/m"),
    (near, "cruise: precompensation", "cruise_precompensation", 1500, 0.5, "N s/m"),
    (near, "cruise to 10 m/s: settling", "cruise_first.settling_time_s", 2.59, 0.005, "s"),
    (near, "cruise to 7 m/s: settling", "cruise_second.settling_time_s", 2.59, 0.005, "s"),
    (near, "cruise: overshoot", "cruise_first.overshoot_percent", 0, 1e-6, "%"),
    (near, "cruise: first control", "cruise_start_kn", 15, 0.05, "kN"),
    (near, "cruise within 500 N: v(30 s)", "cruise_limited_speed", 7.77, 0.005, "m/s"),
    (below, "cruise within 500 N: top speed", "cruise_limited_peak", 10, "m/s"),
    (near, "cruise, P 600: gain at rest", "cruise_proportional_rest", 0.923, 5e-4),
    (near, "cruise, lag: gain at rest", "cruise_lag_rest", 0.9962, 5e-5),
    (near, "cruise, lag: settling", "cruise_lag.settling_time_s", 8.3, 0.05, "s"),
    (near, "bus: fast pair, real part", "bus_fast_pole.real", -481, 0.5, "1/s"),
    (near, "bus: fast pair, imaginary part", "bus_fast_pole.imag", 1253, 0.5, "rad/s"),
    (near, "bus: middle pair, real part", "bus_middle_pole.real", -2.96, 0.01, "1/s"),
    (near, "bus: middle pair, imaginary part", "bus_middle_pole.imag", 12.8, 0.05, "rad/s"),
    (near, "bus: slow pole", "bus_slow_pole.real", -0.016, 5e-4, "1/s"),
    (near, "bus, road step: peak travel", "bus_peak_mm", 4.82, 0.005, "mm"),
    (near, "bus, road step: below 2 mm after", "bus_below_2_mm_s", 0.36, 0.005, "s"),
    (near, "bus, road step: below 2 % of peak", "bus_settling_s", 1.36, 0.005, "s"),
    (near, "bus, road step: body within 5 %", "bus_body_settling_s", 1.0, 0.05, "s"),
    (near, "bus, road step: largest force", "bus_force_mn", 1.5, 0.05, "MN"),
    (near, "bus without control: beyond 5 mm until", "bus_open_beyond_5_mm_s", 25.8, 0.05, "s"),
    (near, "bus, PID: peak travel", "bus_pid_peak_mm", 5.05, 0.01, "mm"),
    (near, "bus, PID: within 5 mm after", "bus_pid_within_5_mm_s", 0.065, 0.001, "s"),
    (refused, "bus with its integrator: precompensation", _precompensation_with_integrator,
     "of size 6 is singular"),
    (_entries, "pitch, p = 50: K", "pitch_gain", "-0.643457", "169.695", "7.07107"),
    (near, "pitch, p = 50: precompensation", "pitch_precompensation", 7.07107, 5e-6),
    (near, "pitch: slow pole", "pitch_slow_pole.real", -0.153, 5e-4, "1/s"),
    (near, "pitch: fast pair, real part", "pitch_fast_pole.real", -1.94, 0.005, "1/s"),
    (near, "pitch: fast pair, imaginary part", "pitch_fast_pole.imag", 2.10, 0.005),
    (near, "pitch to 0.2 rad: rise", "pitch_small.rise_time_s", 0.72, 0.005, "s"),
    (near, "pitch to 0.2 rad: settling", "pitch_small.settling_time_s", 2.01, 0.005, "s"),
    (near, "pitch to 0.2 rad: overshoot", "pitch_small.overshoot_percent", 5.0, 0.05, "%"),
    (near, "pitch to 0.2 rad: largest elevator angle", "pitch_small_elevator", 1.41, 0.005, "rad"),
    (near, "pitch to 0.5 rad: rise", "pitch_large.rise_time_s", 0.72, 0.005, "s"),
    (near, "pitch to 0.5 rad: settling", "pitch_large.settling_time_s", 2.01, 0.005, "s"),
    (near, "pitch to 0.5 rad: overshoot", "pitch_large.overshoot_percent", 5.0, 0.05, "%"),
    (near, "pitch to 0.5 rad: largest elevator angle", "pitch_large_elevator", 3.54, 0.005, "rad"),
    (_entries, "pitch, p = 2: K", "pitch_soft_gain", "-0.5034", "52.865", "1.4142"),
    (above, "pitch, p = 2: settling", "pitch_soft.settling_time_s", 7, "s"),
    (near, "pitch, lead: overshoot", "pitch_lead.overshoot_percent", 8.2, 0.05, "%"),
    (near, "pitch, lead: settling", "pitch_lead.settling_time_s", 10.4, 0.05, "s"),
    (_entries, "speed: K", "speed_gain", "12.99", "-1.00"),
    (_entries, "speed: K for the sampled poles", "speed_sampled_gain", "12.4747", "-0.93571"),
    (near, "speed: precompensation", "speed_precompensation", 13, 0.005, "V s/rad"),
    (near, "speed: settling", "speed_step.settling_time_s", 1.09, 0.005, "s"),
    (near, "speed: overshoot", "speed_step.overshoot_percent", 0, 0.005, "%"),
    (near, "speed: first voltage", "speed_start_v", 13, 0.005, "V"),
    (near, "speed: voltage at rest", "speed_rest_v", 10.01, 0.005, "V"),
    (near, "speed, PID: settling", "speed_pid.settling_time_s", 0.26, 0.05, "s"),
    (near, "speed, lag: settling", "speed_lag.settling_time_s", 1.32, 0.05, "s"),
    (near, "speed, lag: overshoot", "speed_lag.overshoot_percent", 13.7, 0.05, "%"),
    (_entries, "position, the paper's poles: K", "position_gain", "2000000", "28050", "194"),
    (near, "position, this K at 10 ms: largest |z|", "position_largest_pole", 4.77, 0.005),
    (refused, "position, this K at 10 ms", _hold_the_papers_gain,
     "largest |z| = 4.77, and it must be below 1"),
    (below, "position, this K at 5 ms: largest |z|", "position_largest_pole_5_ms", 1),
    (_entries, "position: K for the sampled poles", "position_sampled_gain",
     "338554", "7048.8", "79.05"),
    (near, "position, sampled poles: settling", "position_fast.settling_time_s", 0.05, 0.005, "s"),
    (near, "position, sampled poles: overshoot", "position_fast.overshoot_percent", 2.5, 0.05, "%"),
    (near, "position, sampled poles: largest voltage per rad", "position_fast_kv", 458, 1, "kV"),
    (_entries, "position, default poles: K", "position_default_gain", "195", "12.99", "6.5"),
    (near, "position, default poles: settling", "position_default.settling_time_s", 1.18, 0.005,
     "s"),
    (at_most, "position, default poles: overshoot", "position_default.overshoot_percent", 0.05,
     "%"),
)  # fmt: skip


def checks_of(loops: NamedFigures) -> list[Check]:
    """Hold the figures of `measure` against the specification's."""
    return checks_from(CHECKS, loops)


# --- Fig. 7: root loci ---------------------------------------------------------------------------

# The tutorial's notch for the bus: zeros near its slow pair -.11 +- 5.25i, poles far left.
NOTCH = Rational((1.0, 6.0, 21.25), (1.0, 90.0, 1800.0))


@dataclass(frozen=True)
class Panel:
    """One locus: the loop that the gain multiplies, and the gains from low to high (k,)."""

    title: str
    loop: Rational
    gains: tuple[float, ...]

    def poles(self) -> np.ndarray:
        """Closed-loop poles (k, degree), each column one branch."""
        return root_locus(self.loop, np.array(self.gains))


def figure_7() -> dict[str, Panel]:
    """Panels by the paper's letters; a gain of 1 is each controller as its plant's file has it.

    The paper gives none of its compensators, so the loci have its shapes and not its numbers. In
    (d) and (e) the gain multiplies the bare notch, so it is in N/m.
    """
    car, aircraft = cruise.transfer_function(), pitch.transfer_function()
    body, _ = suspension.transfer_functions()
    speed, position = motor.speed_transfer_function(), motor.position_transfer_function()
    notched = series(NOTCH, body)
    integral = series(motor.POSITION_PROPORTIONAL_INTEGRAL, position)
    panels = (
        ("a", "cruise, P", series(cruise.PROPORTIONAL, car), 1e-3, 1e3),
        ("b", "cruise, lag", series(cruise.LAG, car), 1e-3, 1e3),
        ("c", "suspension, P", body, 1e2, 1e9),
        ("d", "suspension, notch", notched, 1e2, 1e12),
        ("e", "suspension, notch, near the origin", notched, 1e2, 1e8),
        ("f", "suspension, PID", series(suspension.PID, body), 1e-3, 1e3),
        ("g", "pitch, P", aircraft, 1e-3, 1e3),
        ("h", "pitch, lead", series(pitch.LEAD, aircraft), 1e-3, 1e3),
        ("i", "motor speed, lag", series(motor.SPEED_LAG, speed), 1e-3, 1e3),
        ("j", "motor position, P", series(motor.POSITION_PROPORTIONAL, position), 1e-3, 1e3),
        ("k", "motor position, PI", integral, 1e-3, 1e3),
        ("l", "motor position, PID", series(motor.POSITION_PID, position), 1e-3, 1e3),
    )  # fmt: skip
    return {
        letter: Panel(title, loop, (0.0, *np.geomspace(low, high, 400).tolist()))
        for letter, title, loop, low, high in panels
    }
