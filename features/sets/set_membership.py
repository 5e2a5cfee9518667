"""Set membership in the network: every node keeps a set that holds the truth for certain.

A step carries the node's set and the held sets of its neighbours through the plant, under every
noise that the bounds allow, and cuts with the node's readings. Where the noise of a reading also
drives the plant, the reading narrows the next set too (`filters/joint_noise.py`). A round
cuts with the neighbours' shares. The truth lies in each of these sets, so it lies in their
intersection. The rule needs no weights and cannot count a share twice. A lost share makes the set
wider, but the set still holds the truth.

Readings of a step, or a share, that have nothing in common with the own set contradict the bounds;
they are counted and left out.
"""

from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np

from concord.features.sets.filters.joint_noise import (
    JointMotion,
    LinearReadings,
    joint_motion,
    no_joint_motion,
    noise_gain,
    strips_of,
)
from concord.features.sets.filters.rounding import rounding_bound
from concord.features.sets.set_shapes import HeldSet, Shape, chosen_sets, relative_size
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import multiply
from concord.nodes.rules.at_node import AtNode
from concord.nodes.rules.lane_rule import (
    BID_RESOLUTION,
    FIRST_BID,
    NO_BID,
    Failures,
    LaneContent,
    LocalStep,
    Place,
    mapped,
    older,
)


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

    def bounded_rows(self, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """C (m, n), D (m, q) and half-widths (m,) of a reading y = C x + D v + w.

        v is the noise that drives the plant, as in `BoundedModel.motion`; |w| <= half-widths is the
        sensor's own.
        """
        ...


class OwnSet(NamedTuple, Generic[HeldSet]):
    """The own set, and the one that was last sent, carried on to now; `known` (...) if one was.

    `joint` is what the own readings of this step say of the noise that drives the plant on.
    """

    kept: HeldSet
    published: HeldSet
    known: np.ndarray
    joint: JointMotion


class HeldSets(NamedTuple, Generic[HeldSet]):
    """The sets that neighbours sent last, where one is held; cycles since, (..., J)."""

    sets: HeldSet
    known: np.ndarray
    ages: np.ndarray


_ROUNDING = 1e-9
# Half-widths, relative to the state, that no bid tells from 0.
_NEGLIGIBLE = 2.0**-24

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
        lanes, (*nodes, n) = held.mean.shape[:-1], prior.mean.shape
        unread = no_joint_motion(tuple(nodes), n)
        return LaneContent(
            OwnSet(own, own, np.zeros(nodes, dtype=bool), unread),
            HeldSets(self.shape.containing(held), np.zeros(lanes, dtype=bool), np.full(lanes, -1)),
            0,
        )

    def begin_step(
        self, node: np.ndarray, content: SetContent[HeldSet], now: LocalStep
    ) -> tuple[SetContent[HeldSet], Failures]:
        """Carry every set to this step and cut the own one with the readings."""
        own, held = content.own, content.held
        if now.step > 0:
            own = own._replace(kept=predict_sets(self.shape, own.kept, now, own.joint))
            if self.contends and own.known.any():
                own = own._replace(published=predict_sets(self.shape, own.published, now))
            if held.known.any():
                held = held._replace(sets=predict_sets(self.shape, held.sets, now))
        kept, joint, failures = take_own_readings(self.shape, own.kept, now)
        return LaneContent(own._replace(kept=kept, joint=joint), held, 0), failures

    def bid(self, content: SetContent[HeldSet]) -> np.ndarray:
        """How much smaller the own set is than what neighbours hold of it, quantised.

        The excess of their size relative to the own (`relative_size`), an integer, so that
        arbitration does not hang on the last bit; a node that has never published asks most
        urgently. `NO_BID` where the excess is below the trigger.
        """
        own, widths = content.own, self.shape.half_widths
        # Two sets as narrow as rounding are alike, in every driver.
        least = _NEGLIGIBLE * np.abs(self.shape.centres(own.kept))
        excess = relative_size(widths(own.published) + least, widths(own.kept) + least) - 1.0
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
        return content._replace(own=own._replace(published=published, known=own.known | sends))

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


def predict_sets(
    shape: Shape[HeldSet], sets: HeldSet, now: LocalStep, joint: JointMotion | None = None
) -> HeldSet:
    """Sets of the step before, at this one.

    `joint` is what their readings said of the noise since, in the lanes that had any: it is used
    where it leaves the smaller set.
    """
    model, step = cast(BoundedModel, now.filters.model), now.step - 1
    centres = shape.centres(sets)
    transition, noise = model.motion(step)
    plain = shape.moved(sets, model.transition(centres, now.control, step), transition, noise)
    if joint is None or not joint.known.any():
        return plain
    there = mapped(lambda values: np.where(np.isnan(values), 0.0, values), joint)
    driven = model.transition(np.zeros_like(centres), now.control, step)
    moved = multiply(there.transition, centres) + there.offset + driven
    margin = there.margin + rounding_bound(4) * np.abs(driven)
    narrowed = shape.moved(sets, moved, there.transition, there.noise, margin)
    left = relative_size(shape.half_widths(narrowed), shape.half_widths(plain))
    return chosen_sets(joint.known & (left < 1.0 - _ROUNDING), narrowed, plain)


def take_readings(
    shape: Shape[HeldSet],
    own: HeldSet,
    readings: LinearReadings,
    motion: tuple[np.ndarray, np.ndarray],
) -> tuple[HeldSet, JointMotion, np.ndarray]:
    """Sets (...) after the readings of a step, the motion that these leave, and contradictions.

    Readings of a lane that contradict the bounds are left out together (bool, (...)).
    """
    taken = readings.taken()
    widths = shape.half_widths(own)
    gain = noise_gain(taken, widths)
    strips = strips_of(taken, gain, np.abs(shape.centres(own)) + widths)
    kept, sound = own, np.ones(widths.shape[:-1], dtype=bool)
    for place in range(strips.rows.shape[-2]):
        row = strips.rows[..., place, :]
        if row.any():
            cut, meets = shape.cut(
                kept, row, strips.values[..., place], strips.half_widths[..., place]
            )
            kept, sound = chosen_sets(meets, cut, kept), sound & meets
    kept = chosen_sets(sound, kept, own)
    reach = np.abs(shape.centres(kept)) + shape.half_widths(kept)
    joint = joint_motion(taken, gain, reach, *motion)
    used = sound & ~np.isnan(readings.values).all(axis=-1)
    return kept, joint.where(used), ~sound


def take_own_readings(
    shape: Shape[HeldSet], own: HeldSet, now: LocalStep
) -> tuple[HeldSet, JointMotion, Failures]:
    """The own sets after the readings of their step, as `take_readings`."""
    lanes, n = shape.centres(own).shape[:-1], shape.centres(own).shape[-1]
    wrong, joint = np.zeros(lanes, dtype=bool), no_joint_motion(lanes, n)
    motion = cast(BoundedModel, now.filters.model).motion(now.step)
    for group in now.filters.groups:
        readings = group.of(now.readings)
        if not readings.size or np.isnan(readings).all():
            continue
        seen = readings_of(cast(BoundedSensor, group.sensor), readings, now.step)
        kept, moves, missed = take_readings(shape, mapped(group.of, own), seen, motion)
        own, wrong = mapped(group.put, own, kept), group.put(wrong, missed)
        joint = mapped(group.put, joint, moves)
    return own, joint, {"contradicting-reading": wrong}


def readings_of(sensor: BoundedSensor, readings: np.ndarray, step: int) -> LinearReadings:
    """Readings (..., r, d) of one sensor, of r m numbers in a lane."""
    state, noise, half_widths = sensor.bounded_rows(step)
    count, several = len(half_widths), readings.shape[-2]
    values = readings[..., :count].reshape(*readings.shape[:-2], several * count)
    rows = (several, 1)
    return LinearReadings(
        np.tile(state, rows), np.tile(noise, rows), np.tile(half_widths, several), values
    )
