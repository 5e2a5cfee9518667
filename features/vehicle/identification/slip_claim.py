"""Noise with which the filter claims the errors of its side slip.

The likelihood judges predictions of the next reading. Errors of the tyres last longer than a step,
so a filter that hears no side slip errs by more than it claims. Here it does not hear that of the
log, which only judges it; a run does not hear it either. The lateral acceleration tells the side
slip by the tyres alone, so its noise grows with the process noise of the side slip.
"""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.features.vehicle.identification.lane_filter import LaneFilter
from concord.features.vehicle.identification.likelihood import squared
from concord.features.vehicle.identification.logged_readings import LoggedReadings
from concord.features.vehicle.plant.model import Tyre
from concord.features.vehicle.plant.network import SIDE_SLIP
from concord.features.vehicle.plant.parameters import Car
from concord.results.figures.intervals import Interval, batch_means

FACTORS = 2.0 ** np.arange(0.0, 6.5, 0.5)
"""Of noise, tried side by side."""
_UNHEARD_RAD = 10.0
"""Noise of a slip sensor that tells nothing."""


class SlipClaim(NamedTuple):
    """Judgement of the side slip of a log on the claim of a filter that does not hear it.

    Attributes:
        anees: of the side slip, with the noise that the fit found, or the least process noise.
        factor: by which the written car has more noise, 1 or more (`covering`).
        nis: of the other sensors with that noise.
    """

    anees: Interval
    factor: float
    nis: float


def slip_claim(
    log: LoggedReadings, car: Car, tyre: Tyre, least_rad: float, *, by_reference: bool
) -> SlipClaim:
    """Judge a car by the side slip of a log.

    The factor is that with which ANEES is 1, where ANEES is above 1 and its interval too. Beside a
    reference ANEES alone decides.

    Args:
        log: with side slip.
        car: as the fit found it; the noise of its slip sensor is that of the side slip.
        tyre: law of the lateral force.
        least_rad: least process noise of the side slip.
        by_reference: whether the side slip is that of a reference. Its errors add to the difference
            from the filter's, and those that both share cancel: it stands for the truth.
    """
    sheet, count, lanes = car.sensors.side_slip, len(FACTORS), covering(car, least_rad, FACTORS)
    known = 0.0 if by_reference else sheet.noise**2
    deaf = replace(lanes.sensors, side_slip=replace(sheet, noise=_UNHEARD_RAD))
    filtered = LaneFilter(log, replace(lanes, sensors=deaf), tyre, count)
    of_slip = np.array([name == "side_slip" for name in log.sensors])
    squares, totals, freedoms = [], np.zeros(count), 0
    for reading, counts, found in filtered.updates():
        innovation = np.where(counts, found.innovation, np.nan)
        totals += squared(innovation, found.innovation_cov)
        freedoms += int(np.isfinite(innovation[0, ~of_slip]).sum())
        estimates = found.belief
        for error in (reading - filtered.slip(estimates.mean)[:, None])[:, of_slip & counts[0]].T:
            if np.isfinite(error).all():
                claimed = estimates.cov[:, SIDE_SLIP, SIDE_SLIP] + known
                squares.append(np.square(error) / claimed)
    every = np.stack(squares)
    judged, factor = batch_means(every[:, 0]), 1.0
    if by_reference or judged.low > 1:
        factor = least_covering(every.mean(axis=0))
    total = np.interp(np.log(factor), np.log(FACTORS), totals)
    return SlipClaim(judged, factor, float(total) / freedoms)


def least_covering(anees: np.ndarray) -> float:
    """The least factor with which ANEES is 1, given those (k,) of `FACTORS`; the best without one.

    ANEES falls with the factor, until the sigma points are too far apart for the tyres.
    """
    fallen = np.minimum.accumulate(anees[: anees.argmin() + 1])
    return float(np.exp(np.interp(0.0, -np.log(fallen), np.log(FACTORS[: len(fallen)]))))


def covering(car: Car, least_rad: float, factor: np.ndarray | float) -> Car:
    """The car with so much more noise of what tells the side slip; an array makes lanes.

    Its process noise of side slip is at least `least_rad` before.
    """
    sensors, process = car.sensors, car.process_noise
    sheet, noise_rad = sensors.lateral_acceleration, max(process.side_slip_rad, least_rad)
    return replace(
        car,
        process_noise=replace(process, side_slip_rad=noise_rad * factor),
        sensors=replace(sensors, lateral_acceleration=replace(sheet, noise=sheet.noise * factor)),
    )
