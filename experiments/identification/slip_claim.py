"""Process noise with which the filter claims the errors of its side slip.

The likelihood judges predictions of the next reading. Errors of the tyres last longer than a step,
so a filter that hears no side slip errs by more than it claims. Here it does not hear that of the
log, which only judges it; a run does not hear it either.
"""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.experiments.identification.lane_filter import LaneFilter
from concord.experiments.identification.likelihood import squared
from concord.experiments.identification.logged_readings import LoggedReadings
from concord.experiments.monte_carlo.intervals import Interval
from concord.experiments.results.run_verdict import anees_interval
from concord.plants.vehicle.model import Tyre
from concord.plants.vehicle.parameters import Car

_FACTORS = 2.0 ** np.arange(0.0, 6.5, 0.5)
_UNHEARD_RAD = 10.0
"""Noise of a slip sensor that tells nothing."""


class SlipClaim(NamedTuple):
    """Judgement of the side slip of a log on the claim of a filter that does not hear it.

    Attributes:
        anees: of the side slip, with the process noise that the fit found.
        factor: process noise of the written car over that which the fit found, 1 or more.
        nis: of the other sensors with that process noise.
    """

    anees: Interval
    factor: float
    nis: float


def slip_claim(log: LoggedReadings, car: Car, tyre: Tyre, least_rad: float) -> SlipClaim:
    """Judge a car by the side slip of a log.

    The factor is that with which ANEES is 1, where the interval of ANEES lies above 1.

    Args:
        log: with side slip.
        car: as the fit found it; the noise of its slip sensor is that of the side slip.
        tyre: law of the lateral force.
        least_rad: least process noise of the written car.
    """
    sheet, noise, count = car.sensors.side_slip, car.process_noise, len(_FACTORS)
    deaf = replace(car.sensors, side_slip=replace(sheet, noise=_UNHEARD_RAD))
    noises = replace(noise, side_slip_rad=noise.side_slip_rad * _FACTORS)
    lanes = replace(car, sensors=deaf, process_noise=noises)
    of_slip = np.array([name == "side_slip" for name in log.sensors])
    squares, totals, freedoms = [], np.zeros(count), 0
    for innovation, cov in LaneFilter(log, lanes, tyre, count).blocks():
        claimed = np.diagonal(cov, axis1=-2, axis2=-1) - _UNHEARD_RAD**2 + sheet.noise**2
        each = np.square(innovation[..., of_slip]) / claimed[..., of_slip]
        squares.append(each[np.isfinite(each).all(axis=(1, 2))].mean(axis=-1))
        totals += squared(innovation, cov).sum(axis=0)
        freedoms += int(np.isfinite(innovation[:, 0, ~of_slip]).sum())
    every = np.concatenate(squares)
    found, factor = anees_interval(every[:, 0]), max(1.0, least_rad / noise.side_slip_rad)
    if found.low > 1:
        # Means fall with the factor.
        right = np.interp(0.0, -np.log(every.mean(axis=0)), np.log(_FACTORS))
        factor = max(factor, float(np.exp(right)))
    total = np.interp(np.log(factor), np.log(_FACTORS), totals)
    return SlipClaim(found, factor, float(total) / freedoms)
