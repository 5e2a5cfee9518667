"""Set membership in the network: every node keeps a set that holds the truth for certain.

A step carries the node's set and the held sets of its neighbours through the plant, under every
noise that the bounds allow, and cuts with the node's readings. A round cuts with the neighbours'
shares. The truth lies in each of these sets, so it lies in their intersection. The rule needs no
weights and cannot count a share twice. A lost share makes the set wider, but the set still holds
the truth.

A reading or a share that has nothing in common with the own set contradicts the bounds; it is
counted and left out.
"""

from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.nodes.bids import BID_RESOLUTION, FIRST_BID, NO_BID
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.lane_rule import Failures, LaneContent, LocalStep, Place, mapped, older
from concord.nodes.rules.set_shapes import HeldSet, Shape, chosen_sets


@runtime_checkable
class BoundedModel(Protocol):
    """A node's model of the plant: x' = A x + known input + B v with |v| <= 1."""

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """Where the plant takes a state (..., n) between step and step + 1 without noise."""
        ...

    def motion(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """A (n, n) and B (n, q), in units of the noise's bound."""
        ...


@runtime_checkable
class BoundedSensor(Protocol):
    """A node's model of its readings."""

    def strips(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows (m, n) and half-widths (m,): a reading (m,) is off by at most the half-widths."""
        ...


class OwnSet(NamedTuple, Generic[HeldSet]):
    """The own set, and the one that was last sent, carried on to now; `known` (...) if one was."""

    kept: HeldSet
    published: HeldSet
    known: np.ndarray


class HeldSets(NamedTuple, Generic[HeldSet]):
    """The sets that neighbours sent last, where one is held; cycles since, (..., J)."""

    sets: HeldSet
    known: np.ndarray
    ages: np.ndarray


_ROUNDING = 1e-9

SetContent = LaneContent[OwnSet[HeldSet], HeldSets[HeldSet]]


@dataclass(frozen=True)
class SetMembership(Generic[HeldSet]):
    """The rules that keep sets of a shape, as a `LaneRule`.

    Priors have the shape matrix of the set that holds the state at the beginning as covariance;
    `carried` says whether the sets of silent neighbours are held and carried through the plant.
    """

    shape: Shape[HeldSet]
    carried: bool = True
    trigger: float = 0.0
    contends: bool = True

    def start(self, node: np.ndarray, prior: Gaussian, held: Gaussian) -> SetContent[HeldSet]:
        """The prior, and nothing held."""
        own = self.shape.containing(prior)
        lanes = held.mean.shape[:-1]
        return LaneContent(
            OwnSet(own, own, np.zeros(prior.mean.shape[:-1], dtype=bool)),
            HeldSets(self.shape.containing(held), np.zeros(lanes, dtype=bool), np.full(lanes, -1)),
            0,
        )

    def begin_step(
        self, node: np.ndarray, content: SetContent[HeldSet], now: LocalStep
    ) -> tuple[SetContent[HeldSet], Failures]:
        """Carry every set to this step and cut the own one with the readings."""
        own, held = content.own, content.held
        if now.step > 0:
            own = own._replace(kept=predict_sets(self.shape, own.kept, now))
            if self.contends and own.known.any():
                own = own._replace(published=predict_sets(self.shape, own.published, now))
            if held.known.any():
                held = held._replace(sets=predict_sets(self.shape, held.sets, now))
        kept, failures = take_strips(self.shape, own.kept, now)
        return LaneContent(own._replace(kept=kept), held, 0), failures

    def bid(self, content: SetContent[HeldSet]) -> np.ndarray:
        """How much smaller the own set is than what neighbours hold of it, quantised.

        The relative excess of their size, an integer, so that arbitration does not hang on the last
        bit; a node that has never published asks most urgently. `NO_BID` where the excess is below
        the trigger.
        """
        own = content.own
        excess = self.shape.size(own.published) / self.shape.size(own.kept) - 1.0
        urgency = np.clip(np.maximum(excess, 0.0) / BID_RESOLUTION, 0, FIRST_BID - 1)
        # A set that has not changed has an excess of 0 but for rounding.
        bids = np.where(excess < self.trigger - _ROUNDING, NO_BID, urgency.astype(np.int64))
        return np.where(own.known, bids, FIRST_BID)

    def say(self, content: SetContent[HeldSet]) -> np.ndarray:
        """The own set."""
        return self.shape.numbers_of(content.own.kept)

    def sent(self, content: SetContent[HeldSet], sends: np.ndarray) -> SetContent[HeldSet]:
        """The node remembers what its neighbours now hold of it."""
        own = content.own
        published = chosen_sets(sends, own.kept, own.published)
        return content._replace(own=OwnSet(own.kept, published, own.known | sends))

    def read(self, numbers: np.ndarray) -> tuple[HeldSet, np.ndarray, str]:
        """Sets around those that were said."""
        came, sound = self.shape.read(numbers)
        return came, sound, "not-positive-definite"

    def fuse(
        self, place: Place, content: SetContent[HeldSet], shares: HeldSet, heard: np.ndarray
    ) -> tuple[SetContent[HeldSet], Failures]:
        """Cut the own set with what came; in the first round of a step with what is held too."""
        own, held, cycles, _ = content
        # Later in a step what is held has cut already.
        active = heard | held.known if cycles == 0 else heard
        others = chosen_sets(heard, shares, held.sets)
        contradicting = np.zeros(heard.shape, dtype=bool)
        kept = own.kept
        for j in range(heard.shape[-1]):
            here = active[..., j]
            if not here.any():
                continue
            # A lane without a share meets itself.
            other = chosen_sets(here, _neighbour(others, j, heard.ndim), kept)
            both, meets = self.shape.meet(kept, other)
            kept = chosen_sets(here & meets, both, kept)
            contradicting[..., j] = here & ~meets
        ages = np.where(contradicting, -1, np.where(heard, 0, older(held.ages)))
        known = (heard & self.carried | ~heard & held.known) & ~contradicting
        failures = {"contradicting-share": contradicting.sum(axis=-1)}
        return LaneContent(
            own._replace(kept=kept), HeldSets(others, known, ages), cycles + 1
        ), failures

    def belief(self, content: SetContent[HeldSet]) -> Gaussian:
        """Centre and shape matrix of an ellipsoid around the own set."""
        return self.shape.bounds(content.own.kept)

    def ages(self, content: SetContent[HeldSet]) -> np.ndarray:
        """Cycles since each neighbour's set was sent."""
        return content.held.ages


class SetAtNode(AtNode[OwnSet[HeldSet], HeldSets[HeldSet], HeldSet]):
    """A set-membership rule at one node, which can tell the zonotope that it keeps."""

    def generators(self, content: SetContent[HeldSet]) -> np.ndarray | None:
        """The generators (n, q) of the own set, where it is a zonotope."""
        rule = cast(SetMembership[HeldSet], self.rule)
        return rule.shape.generators_of(content.own.kept)


def _neighbour(sets: HeldSet, place: int, lanes: int) -> HeldSet:
    """Those of one neighbour, of sets (..., J) with so many axes of lanes."""
    return mapped(lambda values: np.take(values, place, axis=lanes - 1), sets)


def predict_sets(shape: Shape[HeldSet], sets: HeldSet, now: LocalStep) -> HeldSet:
    """Sets of the step before, at this one."""
    model, step = cast(BoundedModel, now.filters.model), now.step - 1
    centres = model.transition(shape.centres(sets), now.control, step)
    return shape.moved(sets, centres, *model.motion(step))


def take_strips(shape: Shape[HeldSet], own: HeldSet, now: LocalStep) -> tuple[HeldSet, Failures]:
    """The own sets after the readings, one number after the other, and what went wrong."""
    wrong = np.zeros(shape.centres(own).shape[:-1], dtype=np.int64)
    for group in now.filters.groups:
        rows, half_widths = cast(BoundedSensor, group.sensor).strips(now.step)
        kept, readings, missed = mapped(group.of, own), group.of(now.readings), group.of(wrong)
        for number in range(readings.shape[-2]):
            values = np.moveaxis(readings[..., number, :], -1, 0)
            for row, value, half_width in zip(rows, values, half_widths, strict=True):
                taken = ~np.isnan(value)
                if not taken.any():
                    continue
                # A lane without a reading is cut by its own centre.
                centre = (shape.centres(kept) * row).sum(axis=-1)
                both, meets = shape.cut(kept, row, np.where(taken, value, centre), half_width)
                kept = chosen_sets(taken & meets, both, kept)
                missed = missed + (taken & ~meets)
        own = mapped(group.put, own, kept)
        wrong = group.put(wrong, missed)
    return own, {"contradicting-reading": wrong}
