"""The closed loops of the consensus paper against the figures of the specification."""

import numpy as np

from concord.features.control import motor, suspension
from concord.features.control.design import continuous_gain_feedback, precompensation
from concord.features.control.references import constant
from concord.papers.kit.checks import Check, above, at_most, below, near, refused
from concord.papers.wac.loops import Loops


def checks_of(loops: Loops) -> list[Check]:
    """The specification's figures, each to the digits printed there."""
    return [
        *_cruise_checks(loops),
        *_bus_checks(loops),
        *_pitch_checks(loops),
        *_speed_checks(loops),
        *_position_checks(loops),
    ]


def _cruise_checks(loops: Loops) -> list[Check]:
    return [
        near("cruise: gain K", loops.cruise_gain, 1450, 0.5, "N s/m"),
        near("cruise: precompensation", loops.cruise_precompensation, 1500, 0.5, "N s/m"),
        near("cruise to 10 m/s: settling", loops.cruise_first.settling_time_s, 2.59, 0.005, "s"),
        near("cruise to 7 m/s: settling", loops.cruise_second.settling_time_s, 2.59, 0.005, "s"),
        near("cruise: overshoot", loops.cruise_first.overshoot_percent, 0, 1e-6, "%"),
        near("cruise: first control", loops.cruise_start_n / 1e3, 15, 0.05, "kN"),
        near("cruise within 500 N: v(30 s)", loops.cruise_limited_speed, 7.77, 0.005, "m/s"),
        below("cruise within 500 N: top speed", loops.cruise_limited_peak, 10, "m/s"),
        near("cruise, P 600: gain at rest", loops.cruise_proportional_rest, 0.923, 5e-4),
        near("cruise, lag: gain at rest", loops.cruise_lag_rest, 0.9962, 5e-5),
        near("cruise, lag: settling", loops.cruise_lag_settling_s, 8.3, 0.05, "s"),
    ]


def _bus_checks(loops: Loops) -> list[Check]:
    poles = loops.bus_poles
    plant = suspension.dynamics()
    transition, control_matrix = plant.sampled(suspension.TIME_STEP_S)
    summed = np.block(
        [
            [transition, np.zeros((4, 1))],
            [suspension.TIME_STEP_S * plant.output_row, np.ones((1, 1))],
        ]
    )
    control = np.append(control_matrix, [[0.0]], axis=0)
    row = np.append(plant.output_row, [[0.0]], axis=1)
    return [
        near("bus: fast pair, real part", poles[0].real, -481, 0.5, "1/s"),
        near("bus: fast pair, imaginary part", abs(poles[0].imag), 1253, 0.5, "rad/s"),
        near("bus: middle pair, real part", poles[2].real, -2.96, 0.01, "1/s"),
        near("bus: middle pair, imaginary part", abs(poles[2].imag), 12.8, 0.05, "rad/s"),
        near("bus: slow pole", poles[4].real, -0.016, 5e-4, "1/s"),
        near("bus, road step: peak travel", 1e3 * loops.bus_peak_m, 4.82, 0.005, "mm"),
        near("bus, road step: below 2 mm after", loops.bus_below_2_mm_s, 0.36, 0.005, "s"),
        near("bus, road step: below 2 % of peak", loops.bus_settling_s, 1.36, 0.005, "s"),
        near("bus, road step: body within 5 %", loops.bus_body_settling_s, 1.0, 0.05, "s"),
        near("bus, road step: largest force", loops.bus_force_n / 1e6, 1.5, 0.05, "MN"),
        near(
            "bus without control: beyond 5 mm until", loops.bus_open_beyond_5_mm_s, 25.8, 0.05, "s"
        ),
        near("bus, PID: peak travel", 1e3 * loops.bus_pid_peak_m, 5.05, 0.01, "mm"),
        near("bus, PID: within 5 mm after", loops.bus_pid_within_5_mm_s, 0.065, 0.001, "s"),
        refused(
            "bus with its integrator: precompensation",
            lambda: precompensation(summed, control, row, np.zeros((1, 5))),
            "of size 6 is singular",
        ),
    ]


def _pitch_checks(loops: Loops) -> list[Check]:
    checks = [
        *_entries("pitch, p = 50: K", loops.pitch_gain, ("-0.643457", "169.695", "7.07107")),
        near("pitch, p = 50: precompensation", loops.pitch_precompensation, 7.07107, 5e-6),
        near("pitch: slow pole", loops.pitch_poles[2].real, -0.153, 5e-4, "1/s"),
        near("pitch: fast pair, real part", loops.pitch_poles[0].real, -1.94, 0.005, "1/s"),
        near("pitch: fast pair, imaginary part", abs(loops.pitch_poles[0].imag), 2.10, 0.005),
    ]
    expected = {0.2: 1.41, 0.5: 3.54}
    measured = zip(expected, loops.pitch_steps, loops.pitch_deflections_rad, strict=True)
    for reference, figures, deflection in measured:
        name = f"pitch to {reference} rad"
        checks += [
            near(f"{name}: rise", figures.rise_time_s, 0.72, 0.005, "s"),
            near(f"{name}: settling", figures.settling_time_s, 2.01, 0.005, "s"),
            near(f"{name}: overshoot", figures.overshoot_percent, 5.0, 0.05, "%"),
            near(f"{name}: largest elevator angle", deflection, expected[reference], 0.005, "rad"),
        ]
    return [
        *checks,
        *_entries("pitch, p = 2: K", loops.pitch_soft_gain, ("-0.5034", "52.865", "1.4142")),
        above("pitch, p = 2: settling", loops.pitch_soft_settling_s, 7, "s"),
        near("pitch, lead: overshoot", loops.pitch_lead.overshoot_percent, 8.2, 0.05, "%"),
        near("pitch, lead: settling", loops.pitch_lead.settling_time_s, 10.4, 0.05, "s"),
    ]


def _speed_checks(loops: Loops) -> list[Check]:
    return [
        *_entries("speed: K", loops.speed_gain, ("12.99", "-1.00")),
        *_entries(
            "speed: K for the sampled poles", loops.speed_sampled_gain, ("12.4747", "-0.93571")
        ),
        near("speed: precompensation", loops.speed_precompensation, 13, 0.005, "V s/rad"),
        near("speed: settling", loops.speed_step.settling_time_s, 1.09, 0.005, "s"),
        near("speed: overshoot", loops.speed_step.overshoot_percent, 0, 0.005, "%"),
        near("speed: first voltage", loops.speed_start_v, 13, 0.005, "V"),
        near("speed: voltage at rest", loops.speed_rest_v, 10.01, 0.005, "V"),
        near("speed, PID: settling", loops.speed_pid_settling_s, 0.26, 0.05, "s"),
        near("speed, lag: settling", loops.speed_lag.settling_time_s, 1.32, 0.05, "s"),
        near("speed, lag: overshoot", loops.speed_lag.overshoot_percent, 13.7, 0.05, "%"),
    ]


def _position_checks(loops: Loops) -> list[Check]:
    plant = motor.position_dynamics()
    gain, volt = loops.position_gain[None], loops.position_fast_volt
    fast, default = loops.position_fast, loops.position_default
    return [
        *_entries(
            "position, the paper's poles: K", loops.position_gain, ("2000000", "28050", "194")
        ),
        near("position, this K at 10 ms: largest |z|", loops.position_largest_pole, 4.77, 0.005),
        refused(
            "position, this K at 10 ms",
            lambda: continuous_gain_feedback(plant, motor.TIME_STEP_S, gain, constant(1.0)),
            "largest |z| = 4.77, and it must be below 1",
        ),
        below("position, this K at 5 ms: largest |z|", loops.position_largest_pole_5_ms, 1),
        *_entries(
            "position: K for the sampled poles",
            loops.position_sampled_gain,
            ("338554", "7048.8", "79.05"),
        ),
        near("position, sampled poles: settling", fast.settling_time_s, 0.05, 0.005, "s"),
        near("position, sampled poles: overshoot", fast.overshoot_percent, 2.5, 0.05, "%"),
        near("position, sampled poles: largest voltage per rad", volt / 1e3, 458, 1, "kV"),
        *_entries(
            "position, default poles: K", loops.position_default_gain, ("195", "12.99", "6.5")
        ),
        near("position, default poles: settling", default.settling_time_s, 1.18, 0.005, "s"),
        at_most("position, default poles: overshoot", default.overshoot_percent, 0.05, "%"),
    ]


def _entries(name: str, measured: np.ndarray, printed: tuple[str, ...]) -> list[Check]:
    """Each entry of a gain, to half a unit of the last digit printed."""
    return [
        near(f"{name}[{place}]", entry, float(digits), 0.5 * 10.0 ** -_decimals(digits))
        for place, (entry, digits) in enumerate(zip(measured, printed, strict=True), start=1)
    ]


def _decimals(printed: str) -> int:
    return len(printed.partition(".")[2])
