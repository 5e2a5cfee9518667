"""Models, beliefs and readings for a filter, drawn from a number."""

from functools import partial
from typing import NamedTuple

import numpy as np

from concord.filters.filter import Filter
from concord.filters.gaussian import Gaussian
from concord.filters.update import Update
from concord.studies.check.neighbourhoods import LANES, draw_neighbourhood

_MOST_READINGS = 3


class FilterCase(NamedTuple):
    """Beliefs (R, N, n), readings (R, N, m), and a plant with one sensor.

    The plant is x' = F x + curve sin x, the sensor y = H x + curve sin(H x). `units` (n + m,) are
    the factors to other units of states and readings.
    """

    number: int
    belief: Gaussian
    readings: np.ndarray
    F: np.ndarray
    Q: np.ndarray
    H: np.ndarray
    R: np.ndarray
    curve: float
    units: np.ndarray

    @property
    def states(self) -> int:
        """Number of states n."""
        return self.belief.mean.shape[-1]

    def moved(self, points: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
        """Points (S, ..., n) one step later, all in units of `scale` (n,)."""
        points = points / scale
        return scale * (points @ self.F.T + self.curve * np.sin(points))

    def measured(
        self,
        points: np.ndarray,
        scale: np.ndarray | float = 1.0,
        read_scale: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """Readings (S, ..., m) of points (S, ..., n), in units of `read_scale` (m,)."""
        values = (points / scale) @ self.H.T
        return read_scale * (values + self.curve * np.sin(values))

    def predict(self, checked: Filter, belief: Gaussian | None = None) -> Gaussian:
        """The beliefs of the case, or others, one step later."""
        return checked.predict(belief or self.belief, self.moved, self.Q)

    def update(
        self,
        checked: Filter,
        belief: Gaussian | None = None,
        readings: np.ndarray | None = None,
        gate: float | None = None,
    ) -> Update:
        """The beliefs of the case, or others, with its readings or others."""
        readings = self.readings if readings is None else readings
        return checked.update(belief or self.belief, readings, self.measured, self.R, gate=gate)

    def in_units(self, checked: Filter) -> tuple[Gaussian, Gaussian]:
        """Prediction and posterior computed in other units, and returned in those of the case."""
        scale, read_scale = self.units[: self.states], self.units[self.states :]
        both = scale[:, None] * scale
        belief = Gaussian(self.belief.mean * scale, self.belief.cov * both)
        found = (
            checked.predict(belief, partial(self.moved, scale=scale), self.Q * both),
            checked.update(
                belief,
                self.readings * read_scale,
                partial(self.measured, scale=scale, read_scale=read_scale),
                self.R * read_scale[:, None] * read_scale,
            ).belief,
        )
        predicted, posterior = (Gaussian(one.mean / scale, one.cov / both) for one in found)
        return predicted, posterior


def draw_filter_case(number: int, curve: float) -> FilterCase:
    """Return the case of a number; without `curve` plant and sensor are linear."""
    case = draw_neighbourhood(number)
    generator = case.generator
    n, m = case.states, int(generator.integers(1, _MOST_READINGS + 1))
    own = Gaussian(case.beliefs.mean[:, :, 0], case.beliefs.cov[:, :, 0])
    H, root_Q, root_R = (generator.standard_normal(shape) for shape in ((m, n), (n, n), (m, m)))
    return FilterCase(
        number,
        own,
        own.mean @ H.T + generator.normal(0, 2, (*LANES, m)),
        F=np.eye(n) + 0.3 * generator.standard_normal((n, n)),
        Q=0.1 * root_Q @ root_Q.T + 0.01 * np.eye(n),
        H=H,
        R=root_R @ root_R.T + 0.1 * np.eye(m),
        curve=curve,
        units=np.exp(generator.uniform(-3, 3, n + m)),
    )
