"""The twelve root loci of Fig. 7 of the weighted-average-consensus paper, as data."""

from dataclasses import dataclass

import numpy as np

from concord.features.control import cruise, motor, pitch, suspension
from concord.features.control.transfer_functions import Rational, root_locus, series

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


def _gains(low: float, high: float) -> tuple[float, ...]:
    return (0.0, *np.geomspace(low, high, 400).tolist())


def figure_7() -> dict[str, Panel]:
    """Panels by the paper's letters; a gain of 1 is each controller as its plant's file has it.

    The paper gives none of its compensators, so the loci have its shapes and not its numbers. In
    (d) and (e) the gain multiplies the bare notch, so it is in N/m.
    """
    car = cruise.transfer_function()
    body, _ = suspension.transfer_functions()
    aircraft = pitch.transfer_function()
    speed = motor.speed_transfer_function()
    position = motor.position_transfer_function()
    notched = series(NOTCH, body)

    def panel(title: str, plant: Rational, controller: Rational) -> Panel:
        return Panel(title, series(controller, plant), _gains(1e-3, 1e3))

    return {
        "a": panel("cruise, P", car, cruise.PROPORTIONAL),
        "b": panel("cruise, lag", car, cruise.LAG),
        "c": Panel("suspension, P", body, _gains(1e2, 1e9)),
        "d": Panel("suspension, notch", notched, _gains(1e2, 1e12)),
        "e": Panel("suspension, notch, near the origin", notched, _gains(1e2, 1e8)),
        "f": panel("suspension, PID", body, suspension.PID),
        "g": Panel("pitch, P", aircraft, _gains(1e-3, 1e3)),
        "h": panel("pitch, lead", aircraft, pitch.LEAD),
        "i": panel("motor speed, lag", speed, motor.SPEED_LAG),
        "j": panel("motor position, P", position, motor.POSITION_PROPORTIONAL),
        "k": panel("motor position, PI", position, motor.POSITION_PROPORTIONAL_INTEGRAL),
        "l": panel("motor position, PID", position, motor.POSITION_PID),
    }
