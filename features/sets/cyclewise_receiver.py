"""Sets at the receiver of a measurement bus, cut once in a communication cycle.

The sets of Liu et al. (2021) are of the states in all steps of a cycle, found when its last slot is
over. Between these moments the receiver carries the set of the last state through the plant.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.stochastic_ukf import Received
from concord.features.sets.filters.bus_readings import lifted_evidence
from concord.features.sets.filters.ellipsoid import Ellipsoid, from_shape, image, moved
from concord.features.sets.filters.histories import CycleStep, augmented_prior
from concord.features.sets.filters.lifted_cycle import LiftedCycle, augment, lift
from concord.features.sets.filters.tight_estimator import conditioned
from concord.features.sets.set_receivers import (
    ContentionResult,
    HeldValues,
    MeasuredSets,
    first_held,
    lanes_of,
    nothing,
    told_only,
)
from concord.features.sets.set_shapes import Ellipsoids
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import join_entries, multiply


class ReceivedCycle(NamedTuple):
    """A cycle as it was received.

    values: (..., m), those that were sent, and held ones; fresh: (..., m), which were sent. before:
    (..., c), what the contending outputs had sent before. result: of the contended slot.
    """

    lifted: LiftedCycle
    values: np.ndarray
    fresh: np.ndarray
    before: np.ndarray
    result: ContentionResult


CycleCut = tuple[Ellipsoid, Ellipsoid, np.ndarray]


def conditioned_cycle(accuracy: float, kept: Ellipsoid, cycle: ReceivedCycle) -> CycleCut:
    """Cut the set of a state (..., n) with all values of a cycle.

    Returns the set of the states (..., g n) in the steps after, the one to go on with, and the
    duality gap (...) relative to the trace, which is about `accuracy`.
    """
    lifted, result = cycle.lifted, cycle.result
    n = kept.centre.shape[-1]
    values = np.where(cycle.fresh, cycle.values, np.nan)
    evidence = lifted_evidence(lifted, values, cycle.before, result.winner, result.limit)
    after, gap = conditioned(kept, told_only(evidence, result), accuracy=accuracy)
    return after, image(after, np.eye(len(lifted.states))[-n:]), gap


def augmented_cycle(step: CycleStep, kept: Ellipsoid, cycle: ReceivedCycle) -> CycleCut:
    """The paper's estimator, exact or fast, on the augmented state; returns as `conditioned_cycle`.

    Lost values are NaN, and the losers of which the winner tells nothing have no weight.
    """
    lifted, result = cycle.lifted, cycle.result
    contending = len(lifted.weights)
    static = cycle.values.shape[-1] - contending
    winner = np.where(result.heard, result.winner, -1)
    weights = np.where(result.told, lifted.weights, 0.0)
    change = cycle.values[..., static:] - cycle.before
    # Of the contenders the winner alone has changed what it holds.
    of_winner = (weights * change**2).sum(-1)
    excess = np.where(result.told.any(-1), np.maximum(result.limit - of_winner, 0.0), 0.0)
    model = augment(lifted, winner, excess)._replace(weights=weights)
    rows = join_entries(cycle.fresh[..., :static], np.ones(contending, dtype=bool))
    found = step(kept, model, np.where(rows, cycle.values, np.nan))
    states = np.eye(found.after.centre.shape[-1])[: len(lifted.states)]
    return image(found.after, states), found.after, found.gap


CutCycle = Callable[[Ellipsoid, ReceivedCycle], CycleCut]


class CycleSets(NamedTuple):
    """Sets between two events.

    `now` is of the state at this step and `following` at the next, both by what is known so far.
    `kept` is the set at the beginning of the cycle, of the state or augmented. `values` and `fresh`
    (..., m) have come in the cycle. `gap` (...) is the duality gap of `now` where the cycle is
    over, and NaN elsewhere.
    """

    now: Ellipsoid
    following: Ellipsoid | None
    kept: Ellipsoid
    held: HeldValues
    values: np.ndarray
    fresh: np.ndarray
    gap: np.ndarray


@dataclass(frozen=True)
class CyclewiseReceiver:
    """A set that is cut once a cycle (`concord.features.measurement_bus.reception.Receiver`).

    Attributes:
        static: l, the outputs that are sent in turn; the others contend in the last slot.
        cut: finds the sets after a cycle.
        held_half_width: of the held values at first, for estimators of the augmented state; None
            for those of the state alone.
    """

    measured: MeasuredSets
    static: int
    cut: CutCycle
    held_half_width: float | None

    @property
    def failure(self) -> str:
        """Return the word that is counted where an update fails."""
        return "contradicting-reading"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the lengths of the sensors' measurements."""
        return (1,) * len(self.measured.held)

    def start(self, lanes: tuple[int, ...] = ()) -> CycleSets:
        """Return the set that holds the state at step 0, one of each lane."""
        prior = lanes_of(self.measured.prior, lanes)
        first = from_shape(*prior)
        held = first_held(self.measured, lanes)
        kept = first
        if self.held_half_width is not None:
            contending = held.values[..., self.static :]
            kept = augmented_prior(first, contending, self.static + 1, self.held_half_width)
        untaken = np.zeros(held.values.shape, dtype=bool)
        return CycleSets(first, None, kept, held, held.values, untaken, np.array(np.nan))

    def predict(self, state: CycleSets, control: np.ndarray | None, step: int) -> CycleSets:
        """Return the sets at `step`."""
        if state.following is None:
            # No slot was over since the last prediction.
            state = self.update(state, nothing(state.held), step - 1)
        assert state.following is not None, "an update says what follows"
        return state._replace(now=state.following, following=None, gap=np.array(np.nan))

    def update(self, state: CycleSets, received: Received, step: int) -> CycleSets:
        """Return the sets after the slot of a step."""
        cycle, place = divmod(step, self.static + 1)
        values = np.where(received.fresh, received.values, state.values)
        state = state._replace(values=values, fresh=state.fresh | received.fresh)
        contenders = self.measured.contenders(step)
        after = state.held.after(received, contenders)
        if place < self.static:
            return state._replace(following=self._carried(state.now, step), held=after)
        ended = ReceivedCycle(
            lift(self.measured.system, self.static, self._weights, cycle),
            state.values,
            state.fresh,
            state.held.values[..., self.static :],
            self.measured.contention(step, state.held, received),
        )
        states, kept, gap = self.cut(state.kept, ended)
        n = len(self.measured.prior.mean)
        blocks = np.eye(states.centre.shape[-1]).reshape(self.static + 1, n, -1)
        return CycleSets(
            # Without a step before its last one, a cycle says nothing of its own state.
            image(states, blocks[-2]) if self.static else state.now,
            image(states, blocks[-1]),
            kept,
            after,
            after.values,
            np.zeros(state.fresh.shape, dtype=bool),
            gap,
        )

    def belief(self, state: CycleSets) -> Gaussian:
        """Return centre and shape matrix of the set."""
        return Ellipsoids(len(self.measured.prior.mean)).bounds(state.now)

    def generators(self, state: CycleSets) -> None:
        """Return None: an ellipsoid has no generators."""

    def gap(self, state: CycleSets) -> np.ndarray:
        """Return the duality gap (...) of the set relative to its trace; NaN for none."""
        return state.gap

    def _weights(self, step: int) -> np.ndarray:
        return self.measured.weights_of(np.arange(self.static, len(self.sizes)), step)

    def _carried(self, now: Ellipsoid, step: int) -> Ellipsoid:
        system = self.measured.system
        transition = system.transition(step)
        return moved(
            now, multiply(transition, now.centre), transition, system.scaled_noise_input(step)
        )
