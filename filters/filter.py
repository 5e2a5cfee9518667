"""The interface of a filter: a value that predicts Gaussian beliefs and updates them with readings.

Lanes are free leading axes, as in `concord.filters.ukf`. A filter keeps nothing between calls: its
fields are its settings, and equal arguments give equal bits. A lane that fails is NaN, and fails
alone.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual
from concord.filters.update import Update


@runtime_checkable
class Filter(Protocol):
    """A filter for additive noise. `concord check` holds one against its promises."""

    def predict(self, belief: Gaussian, transition: Model, noise_cov: np.ndarray, /) -> Gaussian:
        """The belief (..., n) one step later.

        `transition` maps points (S, ..., n) to points (S, ..., n) for any S; `noise_cov` is
        (n, n) or (..., n, n).
        """
        ...

    def update(
        self,
        belief: Gaussian,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> Update:
        """The belief (..., n) given a measurement (..., m), whose NaN entries were not taken.

        `measure` maps points (S, ..., n) to predicted measurements (S, ..., m) for any S;
        `noise_cov` is (m, m) or (..., m, m); `residual` is the difference of two measurements. A
        lane with nothing taken keeps its belief bit for bit. So does a lane whose normalised
        innovation squared exceeds the `gate`.
        """
        ...


class Affine(NamedTuple):
    """A measurement about a belief (..., n): y = predicted + slope (x - mean) + an error.

    predicted (..., m), slope (..., m, n), error_cov (..., m, m) without the sensor's noise.
    """

    predicted: np.ndarray
    slope: np.ndarray
    error_cov: np.ndarray


class Linearising(Filter, Protocol):
    """A filter that takes a measurement as an affine function of the state."""

    def linearise(
        self, belief: Gaussian, measure: Model, size: int, residual: Residual, /
    ) -> Affine:
        """The measurement (..., size) about a belief (..., n)."""
        ...
