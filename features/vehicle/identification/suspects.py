"""The parameter of a car that alone explains most of what its file leaves unexplained in a log.

Each parameter is moved alone, with the others as the file has them. A wrong parameter lowers the
likelihood most by being wrong, so the true cause gains most where there is one cause (the
inequality of information). Gains of one parameter are chi-square with one degree of freedom over
two if the file is right (Wilks 1938, The large-sample distribution of the likelihood ratio).
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.identification.fit import NORMAL_95
from concord.features.vehicle.identification.likelihood import likelihood, values_at
from concord.features.vehicle.identification.logged_readings import LoggedReadings
from concord.features.vehicle.identification.sought import Sought, value_at
from concord.features.vehicle.plant.model import Tyre
from concord.features.vehicle.plant.parameters import Car

FALSE_ALARMS = 0.01
LEAST_COUNTED = 100
_TRIED = (-1.0, -0.3, 0.3, 1.0)
_REFINED = 4
"""Number of parameters whose gain is refined."""


class Suspect(NamedTuple):
    """A parameter, its value in the file, the one that fits best, its interval of 95 % under the
    model, and the gain of the logarithm of the likelihood."""

    sought: Sought
    before: float
    value: float
    low: float
    high: float
    gain: float


class _Along(NamedTuple):
    """Values of the negative logarithm of the posterior density (k,) at spreads (k,), ascending."""

    spreads: np.ndarray
    values: np.ndarray

    def with_more(self, spreads: np.ndarray, values: np.ndarray) -> "_Along":
        """The same with more points, each spread once."""
        every, first = np.unique(np.append(self.spreads, spreads), return_index=True)
        return _Along(every, np.append(self.values, values)[first])

    @property
    def best(self) -> int:
        return int(np.nanargmin(self.values))

    def parabola(self) -> tuple[float, float]:
        """Its lowest point and its bend there, through the best point and its neighbours; a bend
        of 0 where the best point is an end, or there is none."""
        middle = self.best
        if not 0 < middle < len(self.values) - 1:
            return float(self.spreads[middle]), 0.0
        three = slice(middle - 1, middle + 2)
        bend, slope, _ = np.polyfit(
            self.spreads[three] - self.spreads[middle], self.values[three], 2
        )
        if not bend > 0:
            return float(self.spreads[middle]), 0.0
        return float(self.spreads[middle] - slope / (2 * bend)), float(2 * bend)

    def refining(self) -> np.ndarray:
        """Spreads to try next: the lowest point of the parabola, and points to either side."""
        if len(self.spreads) == 1:
            return self.spreads
        lowest, bend = self.parabola()
        gaps = np.diff(self.spreads)
        near = gaps[max(0, self.best - 1) : self.best + 1].min() / 3
        if not bend:
            return self.spreads[self.best] + np.array([-2.0, -1.0, 1.0, 2.0]) * 3 * near
        return lowest + np.array([-1.0, 0.0, 1.0]) * min(near, 1.5 / np.sqrt(bend))


def suspect(log: LoggedReadings, car: Car, tyre: Tyre, every: tuple[Sought, ...]) -> Suspect | None:
    """The parameter of a car's file with the largest gain; None where no gain is beyond chance.

    Chance is `FALSE_ALARMS` over the number of parameters (Bonferroni).
    """
    if log.counted.sum() < LEAST_COUNTED:
        return None
    samples = np.array([log.time_step_s / one.spread if one.is_delay else 0.0 for one in every])
    zero = np.zeros(len(every))
    here = likelihood(log, tyre, every, zero, np.ones(len(every)))
    bends = np.where(here.bends > 0, here.bends, np.diagonal(here.information))
    newton = np.clip(-here.gradient / (bends + 1), -2.0, 2.0)
    along = [_Along(np.zeros(1), np.array([here.value])) for _ in every]

    def look(tried: dict[int, np.ndarray]) -> None:
        pairs = [(place, spread) for place, some in tried.items() for spread in some]
        moved = np.zeros((len(pairs), len(every)))
        for lane, (place, spread) in enumerate(pairs):
            step = samples[place]
            moved[lane, place] = step * round(spread / step) if step else spread
        found = values_at(log, tyre, every, moved) + 0.5 * np.square(moved).sum(axis=1)
        for place in tried:
            lanes = [lane for lane, pair in enumerate(pairs) if pair[0] == place]
            along[place] = along[place].with_more(moved[lanes, place], found[lanes])

    look({place: np.append(_TRIED, newton[place]) for place in range(len(every))})
    for _ in range(2):
        gains = [here.value - np.nanmin(one.values) for one in along]
        most = np.argsort(gains)[-_REFINED:].tolist()
        look({place: along[place].refining() for place in most})
    gains = [here.value - np.nanmin(one.values) for one in along]
    place = int(np.argmax(gains))
    if 2 * gains[place] < NormalDist().inv_cdf(FALSE_ALARMS / len(every) / 2) ** 2:
        return None
    before, read = (value_at(one, every[place].path) for one in (car, log.car))
    return _suspect(every[place], before, read, along[place], gains[place])


def _suspect(one: Sought, before: float, read: float, along: _Along, gain: float) -> Suspect:
    at, bend = along.parabola()
    half = NORMAL_95 / np.sqrt(bend) if bend else np.inf
    low, value, high = (float(one.value(read, at + by)) for by in (-half, 0.0, half))
    return Suspect(one, before, value, low, high, float(gain))
