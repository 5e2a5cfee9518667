"""The interface of a filter: a value that predicts Gaussian beliefs and updates them with readings.

Lanes are free leading axes, as in `concord.filters.ukf`. A filter keeps nothing between calls: its
fields are its settings, and equal arguments give equal bits. A lane that fails is NaN, and fails
alone. The memory of a filter that learns is a value too, kept by the caller beside the belief.
"""

from functools import lru_cache
from typing import NamedTuple, Protocol, TypeVar, cast, runtime_checkable

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


Memory = TypeVar("Memory")


@runtime_checkable
class LearningFilter(Filter, Protocol[Memory]):
    """A filter that learns from the readings of a sensor. `update` by itself learns nothing.

    A memory is a named tuple of arrays, or of such tuples; the first axes of each are the lanes.
    """

    def begin(self, shape: tuple[int, ...], /) -> Memory:
        """The memory before the first reading, of a sensor with readings (..., m) of this shape."""
        ...

    def update_and_learn(
        self,
        belief: Gaussian,
        memory: Memory,
        measurement: np.ndarray,
        measure: Model,
        noise_cov: np.ndarray,
        /,
        *,
        residual: Residual = np.subtract,
        gate: float | None = None,
    ) -> tuple[Update, Memory]:
        """As `update`, given what was learnt, and the memory after this reading.

        Entries that are NaN teach nothing. `noise_cov` is the noise of the data sheet.
        """
        ...


@runtime_checkable
class MixtureFilter(Filter, Protocol):
    """A filter whose beliefs are mixtures, each written as one Gaussian of more states."""

    def begun(self, belief: Gaussian, /) -> Gaussian:
        """The mixture that a belief (..., n) begins."""
        ...

    def moments(self, belief: Gaussian, /) -> Gaussian:
        """Mean (..., n) and covariance (..., n, n) of a mixture."""
        ...


@lru_cache
def _is_mixture(kind: type) -> bool:
    # Kept: to ask a protocol takes longer than to predict.
    return issubclass(kind, MixtureFilter)


def begun(filter: Filter, belief: Gaussian) -> Gaussian:
    """The belief of a filter that begins with this one (..., n)."""
    return cast(MixtureFilter, filter).begun(belief) if _is_mixture(type(filter)) else belief


def moments(filter: Filter, belief: Gaussian) -> Gaussian:
    """Mean (..., n) and covariance (..., n, n) of a belief of a filter."""
    return cast(MixtureFilter, filter).moments(belief) if _is_mixture(type(filter)) else belief


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
