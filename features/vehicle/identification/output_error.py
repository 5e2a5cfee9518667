"""Geometry, delays and tyres of a car by output error, which no process noise can explain away.

The logged steering and speed drive the single-track model. The squared errors of yaw rate, lateral
acceleration and side slip are least, each over its own mean square, and the prior of the file with
them. Errors of the model last, so readings that are nearer than `_LASTING_S` count as one.

Source: Ljung (1999), System identification, chapter 7 (output error).
"""

from typing import NamedTuple

import numpy as np

from concord.features.vehicle.identification.lane_filter import LaneFilter
from concord.features.vehicle.identification.logged_readings import LoggedReadings
from concord.features.vehicle.identification.sought import Sought, car_with, told
from concord.features.vehicle.plant.model import Tyre

_LASTING_S = 1.0
_DIFFERENCE = 1e-3
"""Of a parameter, in spreads."""
_STEPS, _LONGEST, _ENOUGH = 25, 1.0, 0.01
"""Most steps; the longest in spreads; the squared length of the last in standard deviations."""
_FAR = 4.0
"""Standard deviations that two estimates of one parameter may be apart."""


class OutputError(NamedTuple):
    """Parameters (p,) in spreads from those of the file, and their standard deviations (p,).

    Noise, and values that the drive does not tell, stay at the file, with an infinite deviation.
    """

    spreads: np.ndarray
    std: np.ndarray

    def is_far(self, spreads: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Which of the likeliest parameters (p,) differ from these by more than chance.

        Where the model is right, both estimates go to the truth; these do so where its errors last,
        too. Source: Hausman (1978), Specification tests in econometrics.
        """
        return np.abs(spreads - self.spreads) > _FAR * np.hypot(std, self.std)


def by_output_error(log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...]) -> OutputError:
    """Return the parameters with which the model follows a drive best.

    Args:
        log: its car is the prior.
        tyre: law of the lateral force.
        sought: parameters (p,) of the car; noise among them stays as it is.
    """
    kept = np.array([not one.is_noise for one in sought])

    def some() -> tuple[Sought, ...]:
        return tuple(one for one, keep in zip(sought, kept, strict=True) if keep)

    at, precision = _least(log, tyre, some())
    seen = told(some(), precision)
    if not seen.all():
        kept[kept] = seen
        at, precision = _least(log, tyre, some())
    spreads, std = np.zeros(len(sought)), np.full(len(sought), np.inf)
    spreads[kept], std[kept] = at, np.sqrt(np.diagonal(np.linalg.inv(precision)))
    return OutputError(spreads, std)


def _least(
    log: LoggedReadings, tyre: Tyre, sought: tuple[Sought, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The parameters (p,) of least squares, by the method of Gauss and Newton, and their precision
    (p, p). A step that makes the squares larger is halved."""
    at, step = np.zeros((2, len(sought)))
    least, each = np.inf, np.eye(len(sought))
    precision, lasting = each, len(log.readings) * log.time_step_s / _LASTING_S
    for _ in range(_STEPS):
        there = at + step
        lanes = there + np.concatenate([np.zeros((1, len(each))), _DIFFERENCE * each])
        left = LaneFilter(log, car_with(log.car, sought, lanes), tyre, len(lanes)).left_over()
        # Delays move different readings to the ends, which count in no lane then.
        there_in_all = np.all(np.isfinite(left), axis=1)
        left = np.where(np.expand_dims(there_in_all, 1), left, 0.0)[
            ..., np.any(there_in_all, axis=0)
        ]
        squares = (left[:, 0] ** 2).sum(axis=0)
        cost = float(lasting * np.log(squares).sum() + there @ there) / 2
        if cost < least:
            at, least = there, cost
            weights, slopes = lasting / squares, (left[:, 1:] - left[:, :1]) / _DIFFERENCE
            precision = np.einsum("kpm,m,kqm->pq", slopes, weights, slopes) + each
            gradient = np.einsum("kpm,m,km->p", slopes, weights, left[:, 0]) + at
            step = -np.linalg.solve(precision, gradient)
            step *= _LONGEST / np.abs(step).max(initial=_LONGEST)
        else:
            step = step / 2
        if not step @ precision @ step > _ENOUGH:
            break
    return at, precision
