"""Sets at the receiver of a measurement bus, cut step by step.

A slot tells the receiver the values that were sent, which are exact. Where sensors contend for a
slot, it also tells that no loser has changed more than the winner, up to the resolution of the
bus's arbitration. That holds only for a loser whose last sent value the receiver knows. Where a
frame of a contended slot is lost, the receiver does not know the sender, and so it knows the last
sent value of no contender until it hears that contender again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.bus.schedule import Schedule
from concord.features.measurement_bus.measurement_bus import (
    LosingBids,
    WeightsAt,
    bid,
    largest_change,
)
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.features.sets.filters.evidence import (
    BoundedMotion,
    Readings,
    StepReadings,
    bus_evidence,
    no_readings,
)
from concord.features.sets.filters.lifted_cycle import LinearBoundedSystem
from concord.filters.gaussian import Gaussian


@dataclass(frozen=True)
class MeasuredSets:
    """The plant and the bus, as a receiver of sets knows them.

    Attributes:
        system: the plant, with scalar outputs 1..m of the sensors in their order.
        schedule: which sensor may send in which step.
        weights: Q_j (1, 1) of all sensors in a step.
        prior: mean (n,) and shape matrix (n, n) of the ellipsoid that holds the state at step 0.
        held: (m,), values that the receiver holds at first, as the sensors know.
        losing_bids: what a winner's bid tells of the others; None where it tells nothing.
    """

    system: LinearBoundedSystem
    schedule: Schedule
    weights: WeightsAt
    prior: Gaussian
    held: np.ndarray
    losing_bids: LosingBids | None

    def contenders(self, step: int) -> np.ndarray:
        """Return the outputs (c,) of which one is sent in this step; none where more may be."""
        alone = self.schedule.dynamic_slots(step) == 1 and not self.schedule.static_senders(step)
        return np.array(self.schedule.contenders(step) if alone else (), dtype=int) - 1

    def contention(self, step: int, held: "HeldValues", received: Received) -> "ContentionResult":
        """Return what the slot of a step tells of the outputs that contended for it."""
        rows = self.contenders(step)
        if not len(rows):
            lanes = received.fresh.shape[:-1]
            none = np.zeros(lanes, dtype=bool)
            return ContentionResult(
                np.zeros(lanes, dtype=int), none, np.zeros((*lanes, 0), dtype=bool), np.ones(lanes)
            )
        fresh, known = received.fresh[..., rows], held.known[..., rows]
        change = received.values[..., rows] - held.values[..., rows]
        weights = self.weights(step)
        # As the sensors compute them.
        each = [bid(change[..., [j]], weights[row]) for j, row in enumerate(rows)]
        bids = np.stack(each, -1)
        winner, heard = np.argmax(fresh, -1), np.asarray(fresh.any(-1))
        if self.losing_bids is None:
            untold = np.zeros(known.shape, dtype=bool)
            return ContentionResult(winner, heard, untold, np.ones(heard.shape))
        told = heard & (known & fresh).any(-1)
        of_winner = np.where(fresh & told[..., None], bids, -1).max(-1, initial=-1)
        limit = largest_change(self.losing_bids(of_winner))
        return ContentionResult(winner, heard, known & told[..., None], limit)

    def weights_of(self, rows: np.ndarray, step: int) -> np.ndarray:
        """Return the weights (c,) of some outputs in a step."""
        weights = self.weights(step)
        return np.array([weights[row][0, 0] for row in rows])


class HeldValues(NamedTuple):
    """Values that sensors sent last (..., m), and where (..., m) the receiver is sure of them."""

    values: np.ndarray
    known: np.ndarray

    def after(self, received: Received, contenders: np.ndarray) -> "HeldValues":
        """The same after a slot for which these outputs (c,) contended."""
        values = np.where(received.fresh, received.values, self.values)
        known = self.known | received.fresh
        if not len(contenders):
            return HeldValues(values, known)
        # Of a frame that was lost any of them may have been the sender.
        is_lost = ~received.fresh[..., contenders].any(-1, keepdims=True)
        unsure = np.zeros(values.shape[-1], dtype=bool)
        unsure[contenders] = True
        return HeldValues(values, known & ~(unsure & is_lost))


class ContentionResult(NamedTuple):
    """Knowledge of a receiver after a contended slot.

    Attributes:
        winner: (...), which of the contenders was heard, 0 where `heard` (...) is False.
        told: (..., c), of which contenders the winner's change tells something.
        limit: (...), their weighted squared changes were not larger.
    """

    winner: np.ndarray
    heard: np.ndarray
    told: np.ndarray
    limit: np.ndarray


def told_only(evidence: StepReadings, result: ContentionResult) -> StepReadings:
    """Evidence of a contended slot without the strips of which the winner tells nothing."""
    bounded, count = evidence.bounded, result.told.shape[-1]
    if not bounded.values.shape[-1]:
        return evidence
    lost = np.arange(count - 1) + (np.arange(count - 1) >= result.winner[..., None])
    told = np.take_along_axis(result.told, lost, -1)
    values = np.where(told, bounded.values, np.nan)
    return evidence._replace(bounded=bounded._replace(values=values))


class StepSets(NamedTuple):
    """Sets between two events: of the state at this step, and at the next one by the same data.

    `gap` (...) is the duality gap of `now`, NaN where no programme was solved.
    """

    now: Any
    following: Any
    held: HeldValues
    gap: np.ndarray


SetStep = Callable[[Any, StepReadings], tuple[Any, np.ndarray]]
"""A step's work: the set after it, and its duality gap (...) relative to its trace."""


def without_gap(step: Callable[[Any, StepReadings], Any]) -> SetStep:
    """A step that solves no programme, as one whose gap is NaN."""

    def cut(before: Any, evidence: StepReadings) -> tuple[Any, np.ndarray]:
        return step(before, evidence), np.array(np.nan)

    return cut


class KeptShape(Protocol):
    """The shape of a receiver's sets: those of `concord.features.sets.set_shapes`, and others."""

    def containing(self, prior: Gaussian) -> Any:
        """Sets around the ellipsoids with these means and shape matrices."""
        ...

    def bounds(self, own: Any) -> Gaussian:
        """Centre and shape matrix of an ellipsoid around a set."""
        ...

    def generators_of(self, own: Any) -> np.ndarray | None:
        """The generators (n, q) of one zonotope; None of another shape."""
        ...


@dataclass(frozen=True)
class StepwiseReceiver:
    """A set that is cut in every step (`concord.features.measurement_bus.reception.Receiver`).

    The noise of a step drives the state and disturbs the outputs, so readings cut the set of this
    step and that of the next together.
    """

    measured: MeasuredSets
    shape: KeptShape
    step: SetStep

    @property
    def failure(self) -> str:
        """Return the word that is counted where an update fails."""
        return "contradicting-reading"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the lengths of the sensors' measurements."""
        return (1,) * len(self.measured.held)

    def start(self, lanes: tuple[int, ...] = ()) -> StepSets:
        """Return the set that holds the state at step 0, one of each lane."""
        first = self.shape.containing(lanes_of(self.measured.prior, lanes))
        return StepSets(first, first, first_held(self.measured, lanes), np.array(np.nan))

    def predict(self, state: StepSets, control: np.ndarray | None, step: int) -> StepSets:
        """Return the sets at `step`."""
        if state.following is None:
            # No slot was over since the last prediction.
            state = self.update(state, nothing(state.held), step - 1)
        return state._replace(now=state.following, following=None, gap=np.array(np.nan))

    def update(self, state: StepSets, received: Received, step: int) -> StepSets:
        """Return the sets after the slot of a step."""
        system, now = self.measured.system, state.now
        n = len(self.measured.prior.mean)
        noise = system.scaled_noise_input(step)[:, None, :]
        still = BoundedMotion(np.eye(n), np.zeros((n, *noise.shape[1:])))
        seen = self._seen(state.held, received, step)
        contenders = self.measured.contenders(step)
        after, gap = self.step(now, seen(still))
        following, _ = self.step(now, seen(BoundedMotion(system.transition(step), noise)))
        return StepSets(after, following, state.held.after(received, contenders), gap)

    def belief(self, state: StepSets) -> Gaussian:
        """Return centre and shape matrix of an ellipsoid around the set."""
        return self.shape.bounds(state.now)

    def generators(self, state: StepSets) -> np.ndarray | None:
        """Return the generators (n, q) of a zonotope; None of an ellipsoid."""
        return self.shape.generators_of(state.now)

    def gap(self, state: StepSets) -> np.ndarray:
        """Return the duality gap (...) of the set relative to its trace; NaN for none."""
        return state.gap

    def _seen(
        self, held: HeldValues, received: Received, step: int
    ) -> Callable[[BoundedMotion], StepReadings]:
        """Return the evidence of a slot about a motion."""
        measured, rows = self.measured, self.measured.contenders(step)
        if not len(rows):
            rows = np.array(measured.schedule.static_senders(step), dtype=int) - 1
            rows = np.union1d(rows, np.array(measured.schedule.contenders(step), dtype=int) - 1)
            rows = rows.astype(int)
        values = np.where(received.fresh, received.values, np.nan)[..., rows]
        system = measured.system
        outputs = Readings(
            system.output(step)[rows],
            system.scaled_feedthrough(step)[rows][:, None, :],
            values,
            np.zeros(values.shape),
        )
        if not len(measured.contenders(step)):
            return lambda motion: StepReadings(motion, outputs, no_readings(outputs))
        result = measured.contention(step, held, received)
        weights = measured.weights_of(rows, step)
        return lambda motion: told_only(
            bus_evidence(
                motion, outputs, 0, weights, held.values[..., rows], result.winner, result.limit
            ),
            result,
        )


def lanes_of(belief: Gaussian, lanes: tuple[int, ...]) -> Gaussian:
    """A belief (n,) once for each lane."""
    n = belief.mean.shape[-1]
    return Gaussian(
        np.broadcast_to(belief.mean, (*lanes, n)), np.broadcast_to(belief.cov, (*lanes, n, n))
    )


def first_held(measured: MeasuredSets, lanes: tuple[int, ...]) -> HeldValues:
    """The values held at first, which sensors and receiver know."""
    values = np.broadcast_to(measured.held, (*lanes, len(measured.held)))
    return HeldValues(values, np.ones(values.shape, dtype=bool))


def nothing(held: HeldValues) -> Received:
    """A slot in which nothing is heard."""
    return Received(held.values, np.zeros(held.values.shape, dtype=bool))
