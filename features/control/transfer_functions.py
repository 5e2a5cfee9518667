"""Rational functions of s as coefficients, and the classical controllers written with them."""

from typing import Any, NamedTuple

import numpy as np

from concord.features.control.continuous import ContinuousPlant
from concord.features.control.controllers import Compensator, OutputFeedback
from concord.plants.linear import Signal


class Rational(NamedTuple):
    """numerator(s) / denominator(s), coefficients with the highest power first."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def __call__(self, s: complex | np.ndarray) -> np.ndarray:
        """Return the value at a point of the s-plane, or at many."""
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)


def series(first: Rational, second: Rational) -> Rational:
    """Return the product of two transfer functions; what they share is not cancelled."""
    return Rational(
        tuple(np.polymul(first.numerator, second.numerator)),
        tuple(np.polymul(first.denominator, second.denominator)),
    )


def proportional(gain: float) -> Rational:
    """P of (23)."""
    return Rational((gain,), (1.0,))


def proportional_integral(proportional_gain: float, integral_gain: float) -> Rational:
    """PI of (23)."""
    return Rational((proportional_gain, integral_gain), (1.0, 0.0))


def pid(proportional_gain: float, integral_gain: float, derivative_gain: float) -> Rational:
    """PID of (22) and (23)."""
    return Rational((derivative_gain, proportional_gain, integral_gain), (1.0, 0.0))


def lag(gain: float, zero: float, pole: float) -> Rational:
    """gain (s + zero) / (s + pole), (25), with 0 <= pole < zero: raises the gain at rest."""
    if not 0 <= pole < zero:
        raise ValueError(
            f"lag compensator with zero -{zero:g} and pole -{pole:g}: it needs 0 <= pole < zero; "
            "use lead for a pole beyond the zero"
        )
    return Rational((gain, gain * zero), (1.0, pole))


def lead(gain: float, zero: float, pole: float) -> Rational:
    """gain (s + zero) / (s + pole) with 0 <= zero < pole: adds phase near crossover."""
    if not 0 <= zero < pole:
        raise ValueError(
            f"lead compensator with zero -{zero:g} and pole -{pole:g}: it needs 0 <= zero < pole; "
            "use lag for a pole short of the zero"
        )
    return Rational((gain, gain * zero), (1.0, pole))


def sampled_compensator(controller: Rational, time_step_s: float) -> Compensator:
    """Return the controller as a recursion over time steps.

    C(s) = k_d s + d + strictly proper rest: the derivative becomes a backward difference (one
    remembered error), the rest the trapezoidal rule (Tustin), which keeps its gain at rest.
    Raises ValueError for a numerator more than one degree above the denominator.
    """
    import control

    quotient, rest = np.polydiv(controller.numerator, controller.denominator)
    if len(quotient) > 2:
        raise ValueError(
            f"controller with numerator {controller.numerator} over {controller.denominator} "
            "differentiates twice; its numerator may be one degree above its denominator"
        )
    system: Any = control.ss([], [], [], quotient[-1], time_step_s)
    if len(quotient) == 2:
        rate = quotient[0] / time_step_s
        system += control.ss(0, 1, -rate, rate, time_step_s)
    if np.any(rest):
        proper = control.tf2ss(control.tf(rest, controller.denominator))
        system += control.sample_system(proper, time_step_s, method="bilinear")
    return Compensator(system.A, system.B, system.C, system.D)


def output_feedback(
    continuous: ContinuousPlant,
    time_step_s: float,
    controller: Rational,
    signal: Signal,
) -> OutputFeedback:
    """The sampled controller around the plant's controlled output; see sampled_compensator."""
    compensator = sampled_compensator(controller, time_step_s)
    return OutputFeedback(compensator, continuous.output_row, signal)


def root_locus(loop: Rational, gains: np.ndarray) -> np.ndarray:
    """Closed-loop poles (gains, degree) of 1 + gain * loop(s) = 0, each column one branch."""
    import control

    locus: Any = control.root_locus_map(control.tf(*loop), gains=gains)
    return locus.loci
