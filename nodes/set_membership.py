"""Set membership in the network: every node keeps a set that holds the truth for certain.

A step carries the node's set and the held sets of its neighbours through the plant, under every
noise that the bounds allow, and cuts with the node's readings. A round cuts with what neighbours
share. The truth lies in each of these sets, so it lies in what they have in common: nothing needs
weights, nothing can be counted twice, and a share that is lost costs width and never certainty.

A reading or a share that has nothing in common with the own set contradicts the bounds; it is
counted and left out.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from filters.gaussian import Gaussian
from nodes.bids import BID_RESOLUTION, FIRST_BID
from nodes.messages import Array, Measured, from_wire
from nodes.set_shapes import HeldSet, Shape


@runtime_checkable
class BoundedModel(Protocol):
    """What a node knows of the plant: x' = A x + known input + B v with |v| <= 1."""

    def transition(self, state: Array, control: Array | None, step: int) -> Array:
        """Where the plant takes a state (..., n) between step and step + 1 without noise."""
        ...

    def motion(self, step: int) -> tuple[Array, Array]:
        """A (n, n) and B (n, q), in units of the noise's bound."""
        ...


@runtime_checkable
class BoundedSensor(Protocol):
    """What a node knows of its readings."""

    def strips(self, step: int) -> tuple[Array, Array]:
        """Rows (m, n) and half-widths (m,): a reading (m,) is off by at most the half-widths."""
        ...


class Content(NamedTuple):
    """A node's knowledge; `published` is the own set when it last sent, carried on to now."""

    own: HeldSet
    held: tuple[HeldSet | None, ...]
    ages: Array
    published: HeldSet | None
    cycles_in_step: int


@dataclass(frozen=True)
class SetMembership:
    """The estimator at a node with as many neighbours.

    `prior` has the shape matrix of the set that holds the state at the beginning as its covariance;
    `carried` says whether the sets of silent neighbours are held and carried through the plant.
    """

    model: BoundedModel
    sensor: BoundedSensor | None
    prior: Gaussian
    shape: Shape
    neighbours: int
    carried: bool = True
    trigger: float = 0.0

    @property
    def share_bytes(self) -> int:
        """Length of an encoded set."""
        return self.shape.share_bytes

    def start(self) -> Content:
        """The prior, and nothing held."""
        nothing = (None,) * self.neighbours
        return Content(
            self.shape.around(self.prior), nothing, np.full(self.neighbours, -1), None, 0
        )

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Carry every set to this step and cut the own one with the readings."""
        if measured.step > 0:
            content = self._carry(content, measured)
        own, troubles = take_strips(self.shape, content.own, measured, self.sensor)
        return content._replace(own=own, cycles_in_step=0), tuple(troubles)

    def _carry(self, content: Content, measured: Measured) -> Content:
        sets = [content.own, *content.held, content.published]
        present = [place for place, one in enumerate(sets) if one is not None]
        after = carry(self.shape, [sets[place] for place in present], measured, self.model)
        for place, one in zip(present, after, strict=True):
            sets[place] = one
        own, *held, published = sets
        return content._replace(own=own, held=tuple(held), published=published)

    def bid(self, content: Content) -> int | None:
        """How much smaller the own set is than what neighbours hold of it, quantised.

        The relative excess of their size, an integer, so that arbitration does not hang on the last
        bit; who has never published asks most urgently. None where it does not exceed the trigger.
        """
        if content.published is None:
            return FIRST_BID
        excess = self.shape.size(content.published) / self.shape.size(content.own) - 1.0
        if excess < self.trigger:
            return None
        return int(min(max(excess, 0.0) / BID_RESOLUTION, FIRST_BID - 1))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """The own set; the node remembers what its neighbours now hold of it."""
        return content._replace(published=content.own), self.shape.encode(content.own)

    def accept(self, body: bytes) -> HeldSet:
        """The set in a share (`Shape.decode`)."""
        return self.shape.decode(body)

    def fuse(
        self, content: Content, shares: tuple[HeldSet | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """Cut the own set with what came; in the first round of a step with what is held too."""
        ages = np.where(content.ages < 0, -1, content.ages + 1)
        own, held, troubles = content.own, list(content.held), []
        for j, share in enumerate(shares):
            other = share if share is not None else held[j]
            # Later in a step what is held has cut already.
            if other is None or (share is None and content.cycles_in_step > 0):
                continue
            both = self.shape.meet(own, other)
            if both is None:
                troubles.append("contradicting-share")
                held[j], ages[j] = None, -1
                continue
            own = both
            if share is not None:
                ages[j] = 0
                held[j] = share if self.carried else None
        content = Content(own, tuple(held), ages, content.published, content.cycles_in_step + 1)
        return content, tuple(troubles)

    def belief(self, content: Content) -> Gaussian:
        """Centre and shape matrix of an ellipsoid around the own set."""
        return self.shape.bounds(content.own)

    def generators(self, content: Content) -> Array | None:
        """Of the own set, where it is a zonotope."""
        return self.shape.generators_of(content.own)

    def ages(self, content: Content) -> Array:
        """Cycles since each neighbour's set was sent."""
        return content.ages


def carry(
    shape: Shape, sets: list[HeldSet], measured: Measured, model: BoundedModel
) -> list[HeldSet]:
    """Sets of the step before, at that of `measured`."""
    control = None if measured.control is None else np.array(measured.control)
    step = measured.step - 1
    centres = model.transition(np.stack([one.centre for one in sets]), control, step)
    return shape.moved(sets, centres, *model.motion(step))


def take_strips(
    shape: Shape, own: HeldSet, measured: Measured, sensor: BoundedSensor | None
) -> tuple[HeldSet, list[str]]:
    """The set after the readings, one number after the other, and what went wrong."""
    troubles: list[str] = []
    if sensor is None:
        return own, troubles
    rows, half_widths = sensor.strips(measured.step)
    for delivered in from_wire(measured.readings):
        for row, value, half_width in zip(rows, delivered, half_widths, strict=True):
            if np.isnan(value):
                continue
            cut = shape.cut(own, row, value, half_width)
            if cut is None:
                troubles.append("contradicting-reading")
            else:
                own = cut
    return own, troubles
