"""The two shapes of set that a node can keep, ellipsoid and zonotope, and how each travels.

The set on the wire contains the set that was kept. A sender grows its set by the loss of the number
format, a receiver by the loss of decoding. All functions take sets of many lanes (...).
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from concord.features.sets.filters import ellipsoid, zonotope
from concord.features.sets.filters.criterion import unit_free
from concord.features.sets.filters.ellipsoid import Ellipsoid
from concord.features.sets.filters.ellipsoid_intersection import intersection, strip_intersection
from concord.features.sets.filters.rounding import rounding_bound
from concord.features.sets.filters.zonotope import Zonotope
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky
from concord.nodes.rules.lane_rule import mapped
from concord.nodes.share_forms import MEAN_ERROR, TwoByteBelief
from concord.nodes.vector_codec import belief_numbers, belief_of

HeldSet = TypeVar("HeldSet")
_UNITS = {"<f8": 0.0, "<f4": 2.0**-24, "<u2": 0.0}


class Shape(Protocol[HeldSet]):
    """Operations on a node's sets. Each result holds the truth if its operands do."""

    def containing(self, prior: Gaussian) -> HeldSet:
        """The ellipsoids with these means (..., n) and these shape matrices (..., n, n)."""
        ...

    def centres(self, sets: HeldSet) -> np.ndarray:
        """Their centres (..., n)."""
        ...

    def half_widths(self, sets: HeldSet) -> np.ndarray:
        """Their half-widths (..., n) along each state."""
        ...

    def moved(
        self,
        sets: HeldSet,
        centres: np.ndarray,
        transition: np.ndarray,
        noise: np.ndarray,
        margin: np.ndarray | float = 0.0,
    ) -> HeldSet:
        """Sets one step later under x' = A x + B v, |v| <= 1; their centres go to (..., n).

        They grow by a box of half-widths `margin` (..., n).
        """
        ...

    def cut(
        self, own: HeldSet, row: np.ndarray, value: np.ndarray, half_width: np.ndarray
    ) -> tuple[HeldSet, np.ndarray]:
        """Around own and |value - row x| <= half_width, row (..., n); False (...) where they have
        nothing in common, and the set is anything."""
        ...

    def meet(self, own: HeldSet, other: HeldSet) -> tuple[HeldSet, np.ndarray]:
        """Around own and other, not larger than own; False (...) as for `cut`."""
        ...

    def bounds(self, own: HeldSet) -> Gaussian:
        """Centre and shape matrix of an ellipsoid around it."""
        ...

    def generators_of(self, own: HeldSet) -> np.ndarray | None:
        """The generators (n, q) of one zonotope; None of another shape."""
        ...

    def numbers_of(self, own: HeldSet) -> np.ndarray:
        """The numbers (..., m) of sets around these."""
        ...

    def read(self, numbers: np.ndarray) -> tuple[HeldSet, np.ndarray]:
        """Sets around those whose numbers (..., m) were sent; False (...) where these are none."""
        ...


def chosen_sets(chosen: np.ndarray, one: HeldSet, other: HeldSet) -> HeldSet:
    """`one` in the lanes (...) that are chosen, `other` elsewhere."""
    if chosen.all():
        return one

    def pick(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.where(
            chosen.reshape(chosen.shape + (1,) * (first.ndim - chosen.ndim)), first, second
        )

    return mapped(pick, one, other)


def relative_size(widths: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Mean square (...) of half-widths (..., n), each relative to that of another set.

    No unit of a state changes it.
    """
    return ((unit_free(beside) * widths) ** 2).mean(axis=-1)


@dataclass(frozen=True)
class Ellipsoids:
    """Sets of `states` dimensions as centre and shape matrix, on a wire of `number`."""

    states: int
    number: str = "<f8"

    def containing(self, prior: Gaussian) -> Ellipsoid:
        """The ellipsoid itself."""
        return _containing(prior)

    def centres(self, sets: Ellipsoid) -> np.ndarray:
        """Their centres."""
        return sets.centre

    def half_widths(self, sets: Ellipsoid) -> np.ndarray:
        """The roots of the diagonals of their shape matrices."""
        return ellipsoid.half_widths(sets)

    def moved(
        self,
        sets: Ellipsoid,
        centres: np.ndarray,
        transition: np.ndarray,
        noise: np.ndarray,
        margin: np.ndarray | float = 0.0,
    ) -> Ellipsoid:
        """The ellipsoids of least trace."""
        return ellipsoid.moved(sets, centres, transition, noise, margin)

    def cut(
        self, own: Ellipsoid, row: np.ndarray, value: np.ndarray, half_width: np.ndarray
    ) -> tuple[Ellipsoid, np.ndarray]:
        """The ellipsoid of least trace around both."""
        return _found(strip_intersection(own, row, value, half_width))

    def meet(self, own: Ellipsoid, other: Ellipsoid) -> tuple[Ellipsoid, np.ndarray]:
        """The ellipsoid of least trace around both."""
        return _found(intersection(own, other))

    def bounds(self, own: Ellipsoid) -> Gaussian:
        """Its own centre and shape matrix."""
        return Gaussian(own.centre, _rounded_up(ellipsoid.shape_matrix(own), 0.0))

    def generators_of(self, own: Ellipsoid) -> None:
        """It has none."""

    def numbers_of(self, own: Ellipsoid) -> np.ndarray:
        """Centre and shape matrix, grown by what they lose in this number format."""
        unit = _UNITS[self.number]
        if unit > 0.0:
            own = ellipsoid.grow(own, unit * np.abs(own.centre))
        shape = _rounded_up(ellipsoid.shape_matrix(own), unit)
        if self.number == "<u2":
            shape = (1.0 + _growth(self.states)) * shape
        return belief_numbers(Gaussian(own.centre, shape))

    def read(self, numbers: np.ndarray) -> tuple[Ellipsoid, np.ndarray]:
        """False where the shape is not positive definite."""
        return _found(_from_shape(belief_of(numbers, self.states)))


@dataclass(frozen=True)
class Zonotopes:
    """Sets of `states` dimensions with `generators`, some of them zero; shared as parallelotopes.

    All have as many columns, so that the sets of many lanes are one array.
    """

    states: int
    number: str = "<f8"
    generators: int = 20

    def containing(self, prior: Gaussian) -> Zonotope:
        """The box around the ellipsoid along its own axes."""
        return self._reduced(zonotope.around(_containing(prior)))

    def centres(self, sets: Zonotope) -> np.ndarray:
        """Their centres."""
        return sets.centre

    def _reduced(self, own: Zonotope) -> Zonotope:
        return zonotope.reduced_to(own, self.generators)

    def half_widths(self, sets: Zonotope) -> np.ndarray:
        """The half-widths of the boxes around them."""
        return zonotope.half_widths(sets)

    def moved(
        self,
        sets: Zonotope,
        centres: np.ndarray,
        transition: np.ndarray,
        noise: np.ndarray,
        margin: np.ndarray | float = 0.0,
    ) -> Zonotope:
        """The sums, reduced."""
        return self._reduced(zonotope.moved(sets, centres, transition, noise, margin))

    def cut(
        self, own: Zonotope, row: np.ndarray, value: np.ndarray, half_width: np.ndarray
    ) -> tuple[Zonotope, np.ndarray]:
        """Around both; False where the strip misses the zonotope."""
        seen = np.abs((row[..., None] * own.generators).sum(axis=-2)).sum(axis=-1) + half_width
        extent = np.abs(own.centre) + zonotope.half_widths(own)
        reach = (np.abs(row) * extent).sum(axis=-1) + np.abs(value)
        missed = np.abs(value - (row * own.centre).sum(axis=-1))
        meets = missed <= seen + rounding_bound(self.generators) * reach
        both = zonotope.strip_intersection(own, row, value, half_width)
        return self._reduced(both), meets

    def meet(self, own: Zonotope, other: Zonotope) -> tuple[Zonotope, np.ndarray]:
        """Around both; False where their boxes have nothing in common."""
        gap = np.abs(own.centre - other.centre)
        widths = zonotope.half_widths(own) + zonotope.half_widths(other)
        largest = widths + np.abs(own.centre) + np.abs(other.centre)
        meets = np.all(gap <= widths + rounding_bound(self.generators) * largest, axis=-1)
        return self._reduced(zonotope.intersection(own, other)), np.asarray(meets)

    def bounds(self, own: Zonotope) -> Gaussian:
        """An ellipsoid around it."""
        enclosing = zonotope.enclosing_ellipsoid(own)
        return Gaussian(enclosing.centre, _rounded_up(ellipsoid.shape_matrix(enclosing), 0.0))

    def generators_of(self, own: Zonotope) -> np.ndarray:
        """Its own, but for those that are zero."""
        return own.generators[:, own.generators.any(axis=0)]

    def numbers_of(self, own: Zonotope) -> np.ndarray:
        """A parallelotope around it."""
        box = zonotope.parallelotope(own)
        flat = box.generators.reshape(*box.centre.shape[:-1], self.states**2)
        return np.concatenate((box.centre, flat), axis=-1)

    def read(self, numbers: np.ndarray) -> tuple[Zonotope, np.ndarray]:
        """Any finite numbers are a zonotope."""
        n, unit = self.states, _UNITS[self.number]
        came = Zonotope(numbers[..., :n], numbers[..., n:].reshape(*numbers.shape[:-1], n, n))
        if unit > 0.0:
            # Every number that was rounded was within this of the one that came.
            lost = 2.0 * unit * (np.abs(came.centre) + zonotope.half_widths(came))
            came = zonotope.grown(came, lost)
        return self._reduced(came), np.ones(numbers.shape[:-1], dtype=bool)


def set_form(states: int) -> TwoByteBelief:
    """The form of ellipsoids in two bytes a number.

    With `_growth` a, the shape (1 + a) P + (1 + 1 / a) d d' contains the ellipsoid of shape P
    wherever its centre goes by d, and d d' is at most n MEAN_ERROR^2 diag P.
    """
    return TwoByteBelief(states, slack=states * MEAN_ERROR**2 / _growth(states))


def _growth(states: int) -> float:
    """By which part of itself a shape grows, so that the two terms cost about the same."""
    return MEAN_ERROR * states**0.5


def _found(sets: Ellipsoid) -> tuple[Ellipsoid, np.ndarray]:
    return sets, np.asarray(~np.isnan(sets.factor).any(axis=(-2, -1)))


def _rounded_up(shape: np.ndarray, unit: float) -> np.ndarray:
    """Shape matrices (..., n, n) above all that rounding, of their own or by `unit`, makes of them.

    An error of at most e sqrt(P_ii P_jj) in every entry is at most n e diag P.
    """
    n = shape.shape[-1]
    diagonal = np.diagonal(shape, axis1=-2, axis2=-1)
    return shape + np.eye(n) * (n * (2.0 * unit + rounding_bound(n)) * diagonal)[..., None]


def _containing(prior: Gaussian) -> Ellipsoid:
    """Ellipsoids around these, flat in the states whose variance is 0."""
    known = np.diagonal(prior.cov, axis1=-2, axis2=-1) == 0.0
    lifted = Gaussian(prior.mean, prior.cov + np.eye(known.shape[-1]) * known[..., None])
    lower = _from_shape(lifted).factor
    return Ellipsoid(prior.mean, np.where(known[..., None], 0.0, lower))


def _from_shape(belief: Gaussian) -> Ellipsoid:
    """Ellipsoids around these, by Cholesky factors; NaN where a shape is not positive definite."""
    return Ellipsoid(belief.mean, cholesky(_rounded_up(belief.cov, 0.0)))
