"""The two shapes of set that a node can keep, ellipsoid and zonotope, and how each travels.

What is on the wire holds what was kept: a sender grows its set by what the number format loses, a
receiver by what decoding does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from filters import ellipsoid, zonotope
from filters.ellipsoid import Ellipsoid, rounding_bound
from filters.ellipsoid_intersection import intersection, strip_intersection
from filters.gaussian import Gaussian
from filters.linalg import cholesky
from filters.zonotope import Zonotope
from nodes.belief_codec import BeliefCodec
from nodes.estimator import Rejected
from nodes.messages import Array
from nodes.vector_codec import VectorCodec

HeldSet = Any
_UNITS = {"<f8": 0.0, "<f4": 2.0**-24}


class Shape(Protocol):
    """What a node does with its sets. All of them hold the truth if what they are made of does."""

    @property
    def share_bytes(self) -> int:
        """Length of an encoded set."""
        ...

    def around(self, prior: Gaussian) -> HeldSet:
        """The ellipsoid with this mean and this shape matrix (n, n)."""
        ...

    def moved(
        self, sets: Sequence[HeldSet], centres: Array, transition: Array, noise: Array
    ) -> list[HeldSet]:
        """Sets one step later under x' = A x + B v, |v| <= 1; their centres go to (K, n)."""
        ...

    def cut(self, own: HeldSet, row: Array, value: float, half_width: float) -> HeldSet | None:
        """Around own and |value - row x| <= half_width; None where they have nothing in common."""
        ...

    def meet(self, own: HeldSet, other: HeldSet) -> HeldSet | None:
        """Around own and other, not larger than own; None where they have nothing in common."""
        ...

    def bounds(self, own: HeldSet) -> Gaussian:
        """Centre and shape matrix of an ellipsoid around it."""
        ...

    def generators_of(self, own: HeldSet) -> Array | None:
        """The generators (n, q) of a zonotope; None of another shape."""
        ...

    def size(self, own: HeldSet) -> float:
        """Sum of the squared half-widths."""
        ...

    def encode(self, own: HeldSet) -> bytes:
        """A set around it as bytes."""
        ...

    def decode(self, body: bytes) -> HeldSet:
        """A set around the one that was encoded.

        Raises:
            Rejected: bytes that are no set of this network.
        """
        ...


@dataclass(frozen=True)
class Ellipsoids:
    """Sets of `states` dimensions as centre and shape matrix; `number` is "<f8" or "<f4"."""

    states: int
    number: str = "<f8"

    @property
    def _codec(self) -> BeliefCodec:
        return BeliefCodec(self.states, self.number)

    @property
    def share_bytes(self) -> int:
        """Centre and upper triangle of the shape matrix."""
        return self._codec.size

    def around(self, prior: Gaussian) -> Ellipsoid:
        """The ellipsoid itself."""
        return _from_shape(prior)

    def moved(
        self, sets: Sequence[Ellipsoid], centres: Array, transition: Array, noise: Array
    ) -> list[Ellipsoid]:
        """All in one call: arrays cost more to enter than to compute."""
        together = Ellipsoid(np.stack([s.centre for s in sets]), np.stack([s.factor for s in sets]))
        after = ellipsoid.moved(together, centres, transition, noise)
        return [Ellipsoid(*pair) for pair in zip(*after, strict=True)]

    def cut(self, own: Ellipsoid, row: Array, value: float, half_width: float) -> Ellipsoid | None:
        """The ellipsoid of least trace around both."""
        return _sound(strip_intersection(own, row, np.asarray(value), np.asarray(half_width)))

    def meet(self, own: Ellipsoid, other: Ellipsoid) -> Ellipsoid | None:
        """The ellipsoid of least trace around both."""
        return _sound(intersection(own, other))

    def bounds(self, own: Ellipsoid) -> Gaussian:
        """Its own centre and shape matrix."""
        return Gaussian(own.centre, _rounded_up(ellipsoid.shape_matrix(own), 0.0))

    def generators_of(self, own: Ellipsoid) -> None:
        """It has none."""

    def size(self, own: Ellipsoid) -> float:
        """The trace of the shape matrix."""
        return float((own.factor**2).sum())

    def encode(self, own: Ellipsoid) -> bytes:
        """Centre and shape matrix, grown by what they lose in this number format."""
        unit = _UNITS[self.number]
        if unit > 0.0:
            own = ellipsoid.grow(own, unit * np.abs(own.centre))
        shape = _rounded_up(ellipsoid.shape_matrix(own), unit)
        return self._codec.encode(Gaussian(own.centre, shape))

    def decode(self, body: bytes) -> Ellipsoid:
        """Raises Rejected: `belief-length`, `belief-not-finite` or `not-positive-definite`."""
        decoded = _from_shape(self._codec.decode(body))
        if np.isnan(decoded.factor).any():
            raise Rejected("not-positive-definite")
        return decoded


@dataclass(frozen=True)
class Zonotopes:
    """Sets of `states` dimensions with up to `generators`; shared as parallelotopes."""

    states: int
    number: str = "<f8"
    generators: int = 20

    @property
    def _codec(self) -> VectorCodec:
        return VectorCodec(self.states + self.states**2, self.number)

    @property
    def share_bytes(self) -> int:
        """Centre and as many generators as states."""
        return self._codec.size

    def around(self, prior: Gaussian) -> Zonotope:
        """The box around the ellipsoid along its own axes."""
        return zonotope.around(_from_shape(prior))

    def moved(
        self, sets: Sequence[Zonotope], centres: Array, transition: Array, noise: Array
    ) -> list[Zonotope]:
        """One by one: they differ in their number of generators."""
        pairs = zip(sets, centres, strict=True)
        after = [zonotope.moved(s, centre, transition, noise) for s, centre in pairs]
        return [zonotope.reduced(s, self.generators) for s in after]

    def cut(self, own: Zonotope, row: Array, value: float, half_width: float) -> Zonotope | None:
        """Around both; None where the strip misses the zonotope."""
        seen = np.abs(row @ own.generators).sum() + half_width
        reach = np.abs(row) @ (np.abs(own.centre) + zonotope.half_widths(own)) + abs(value)
        missed = abs(value - row @ own.centre)
        if missed > seen + rounding_bound(own.generators.shape[-1]) * reach:
            return None
        both = zonotope.strip_intersection(own, row, np.asarray(value), np.asarray(half_width))
        return zonotope.reduced(both, self.generators)

    def meet(self, own: Zonotope, other: Zonotope) -> Zonotope | None:
        """Around both; None where their boxes have nothing in common."""
        gap = np.abs(own.centre - other.centre)
        widths = zonotope.half_widths(own) + zonotope.half_widths(other)
        largest = widths + np.abs(own.centre) + np.abs(other.centre)
        if (gap > widths + rounding_bound(own.generators.shape[-1]) * largest).any():
            return None
        return zonotope.reduced(zonotope.intersection(own, other), self.generators)

    def bounds(self, own: Zonotope) -> Gaussian:
        """An ellipsoid around it."""
        around = zonotope.enclosing_ellipsoid(own)
        return Gaussian(around.centre, _rounded_up(ellipsoid.shape_matrix(around), 0.0))

    def generators_of(self, own: Zonotope) -> Array:
        """Its own."""
        return own.generators

    def size(self, own: Zonotope) -> float:
        """Sum of the squared half-widths."""
        return float((zonotope.half_widths(own) ** 2).sum())

    def encode(self, own: Zonotope) -> bytes:
        """A parallelotope around it."""
        box = zonotope.parallelotope(own)
        return self._codec.encode(np.concatenate((box.centre, box.generators.ravel())))

    def decode(self, body: bytes) -> Zonotope:
        """Raises Rejected: `share-length` or `share-not-finite`."""
        n, unit = self.states, _UNITS[self.number]
        numbers = self._codec.decode(body)
        came = Zonotope(numbers[:n], numbers[n:].reshape(n, n))
        if unit == 0.0:
            return came
        # Every number that was rounded was within this of the one that came.
        lost = 2.0 * unit * (np.abs(came.centre) + zonotope.half_widths(came))
        return zonotope.grown(came, lost)


def _sound(found: Ellipsoid) -> Ellipsoid | None:
    return None if np.isnan(found.factor).any() else found


def _rounded_up(shape: Array, unit: float) -> Array:
    """A shape matrix (n, n) above every one that rounding, of its own or by `unit`, makes of it.

    An error of at most e sqrt(P_ii P_jj) in every entry is at most n e diag P.
    """
    n = len(shape)
    return shape + np.diag(n * (2.0 * unit + rounding_bound(n)) * np.diagonal(shape))


def _from_shape(belief: Gaussian) -> Ellipsoid:
    """An ellipsoid around it, by Cholesky factors; NaN where the shape is not positive definite."""
    return Ellipsoid(belief.mean, cholesky(_rounded_up(belief.cov, 0.0)))
