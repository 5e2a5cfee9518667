"""Consensus on beliefs: predict, take the own readings, then average with what neighbours share.

A neighbour that was silent in a round is represented by its last share. Shares grow old: the hold
policy says whether a held share is carried through the plant and what it still weighs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from concord.filters.fusion.averaging import Averaged, Directly
from concord.filters.gaussian import Gaussian, joined
from concord.filters.turns import Angles, beside, turns_to_own
from concord.nodes.rules.lane_rule import (
    Failures,
    LaneContent,
    LocalStep,
    Place,
    Published,
    nothing_published,
    older,
)
from concord.nodes.rules.local_filter import finite, finite_lanes, where
from concord.nodes.vector_codec import belief_numbers, belief_of

_ALIKE = np.ones(1)


class HoldPolicy(NamedTuple):
    """Hold policy: how the last share of a silent neighbour is used.

    `weigh(base_weights (..., J), ages (..., J), inverse_volume (..., J), cycles_in_step)` gives
    weights (..., J) that sum to one; entry 0 is the node itself; `cycles_in_step` is 0 in the first
    round of a step. `carried` says that held shares are predicted once per step like the own
    belief. With `by_inverse_volume`, each weight is multiplied by `hold.inverse_volume` of its
    belief (`hold.times_inverse_volume`); else that is 1 for all.
    """

    weigh: Callable[[np.ndarray, np.ndarray, np.ndarray, int], np.ndarray]
    carried: bool
    by_inverse_volume: bool = False


class OwnBelief(NamedTuple):
    """The own belief (..., n), and what neighbours hold of it."""

    belief: Gaussian
    published: Published


class HeldBeliefs(NamedTuple):
    """The last shares of neighbours (..., J, n), cycles since they were sent (..., J), and the
    weights (..., J) that they had in the last round."""

    beliefs: Gaussian
    ages: np.ndarray
    weights: np.ndarray


BeliefContent = LaneContent[OwnBelief, HeldBeliefs]


@dataclass(frozen=True)
class BeliefConsensus:
    """The rules that average beliefs (covariance intersection, the paper's WAC), as a `LaneRule`.

    `angles` are states that are angles: those of a neighbour are put on the turn next to the own.

    Source: the weights of held shares are this project's (`concord.filters.fusion.hold`).
    """

    average: Averaged
    hold: HoldPolicy
    states: int
    trigger: float = 0.0
    contends: bool = True
    angles: Angles = ()

    def start(self, node: np.ndarray, prior: Gaussian, held: Gaussian) -> BeliefContent:
        """The prior, and neighbours never heard (their place holds the prior at no weight)."""
        places = held.mean.shape[:-1]
        nobody = HeldBeliefs(held, np.full(places, -1), np.zeros(places))
        return LaneContent(OwnBelief(prior, nothing_published(prior)), nobody, 0)

    def begin_step(
        self, node: np.ndarray, content: BeliefContent, now: LocalStep
    ) -> tuple[BeliefContent, Failures]:
        """Predict everything that is carried, then take the own readings one by one."""
        own, held = content.own, content.held
        failures: dict[str, np.ndarray] = {}
        if now.step > 0:
            own, held, failures = self._predicted(own, held, now)
        belief, memory, failed = now.update(own.belief, content.memory)
        own = own._replace(belief=belief)
        return LaneContent(own, held, 0, memory), {**failures, **failed}

    def _predicted(
        self, own: OwnBelief, held: HeldBeliefs, now: LocalStep
    ) -> tuple[OwnBelief, HeldBeliefs, dict[str, np.ndarray]]:
        beliefs = [own.belief]
        if self.hold.carried:
            beliefs += [held.beliefs, own.published.belief][: 1 + self.contends]
        (moved, sound), *others = now.predict(*beliefs)
        own = own._replace(belief=where(sound, moved, own.belief))
        failures = {} if sound.all() else {"predict-failed": ~sound}
        if others:
            kept = others[0]
            # A held pair that cannot be carried on is forgotten, not used at a wrong time.
            ages = held.ages if kept.sound.all() else np.where(kept.sound, held.ages, -1)
            known = where(kept.sound, kept.beliefs, held.beliefs)
            held = held._replace(beliefs=known, ages=ages)
        if len(others) > 1:
            own = own._replace(published=own.published.moved(others[1]))
        return own, held, failures

    def bid(self, content: BeliefContent) -> np.ndarray:
        """How far the belief has moved since it was last published."""
        return content.own.published.bid(content.own.belief, self.trigger)

    def say(self, content: BeliefContent) -> np.ndarray:
        """The pair before the iteration."""
        mean, cov = content.own.belief
        return belief_numbers(Gaussian(beside(mean, 0.0, self.angles), cov))

    def sent(self, content: BeliefContent, sends: np.ndarray) -> BeliefContent:
        """The node remembers what its neighbours now hold of it."""
        own = content.own
        if not self.contends:
            return content
        published = own.published.sent(own.belief, sends)
        return content._replace(own=own._replace(published=published))

    def read(self, numbers: np.ndarray) -> tuple[Gaussian, None, str]:
        """Beliefs; whether they are positive definite shows when they are fused."""
        return belief_of(numbers, self.states), None, ""

    def fuse(
        self, place: Place, content: BeliefContent, shares: Gaussian, heard: np.ndarray
    ) -> tuple[BeliefContent, Failures]:
        """Average the own pair with the neighbours' pairs, fresh or held, in sender order."""
        own, before, cycles, _ = content
        if heard.all():
            beliefs, ages = shares, np.zeros(heard.shape, dtype=np.int64)
        else:
            ages = np.where(heard, 0, older(before.ages))
            beliefs = where(heard, shares, before.beliefs)
        weights = self._weights(place.weights, ages, cycles)
        if self.angles:
            means, covs = joined(own.belief, beliefs)
            variances = np.diagonal(covs, axis1=-2, axis2=-1)
            turns = turns_to_own(means, variances, weights, self.angles)
            beliefs = Gaussian(beliefs.mean + turns[..., 1:, :], beliefs.cov)
        fused = self.average.fuse(own.belief, beliefs, weights, self.hold.by_inverse_volume)
        held = HeldBeliefs(beliefs, ages, fused.weights[..., 1:])
        unsound = np.isnan(fused.inverse_volume[..., 1:])
        if unsound.any() and (unsound := heard & unsound).any():
            # Few shares fail this check, and what is held instead is weighed in a second go.
            content, failures = self.fuse(place, content, shares, heard & ~unsound)
            return content, {"rejected not-positive-definite": unsound.sum(axis=-1), **failures}
        if finite(fused.belief):
            own = OwnBelief(fused.belief, own.published)
            return content._replace(own=own, held=held, cycles_in_step=cycles + 1), {}
        sound = finite_lanes(fused.belief)
        belief = where(sound, fused.belief, own.belief)
        own = OwnBelief(belief, own.published)
        after = content._replace(own=own, held=held, cycles_in_step=cycles + 1)
        return after, {"fuse-failed": ~sound}

    def _weights(self, base: np.ndarray, ages: np.ndarray, cycles: int) -> np.ndarray:
        """Return weights (..., 1 + J) of the own pair and the neighbours', without volumes."""
        if ages.ndim > 1:
            return self.hold.weigh(base, _with_own(ages), _ALIKE, cycles)
        return self._kept_weights(base.tobytes(), ages.tobytes(), cycles)

    @cached_property
    def _kept_weights(self) -> Callable[[bytes, bytes, int], np.ndarray]:
        # A node meets the same few patterns of ages again and again.
        @lru_cache
        def weights(base: bytes, ages: bytes, cycles: int) -> np.ndarray:
            own_row, known = np.frombuffer(base), np.frombuffer(ages, dtype=np.int64)
            return self.hold.weigh(own_row, _with_own(known), np.ones(len(own_row)), cycles)

        return weights

    def belief(self, content: BeliefContent) -> Gaussian:
        """The own pair."""
        return content.own.belief

    def ages(self, content: BeliefContent) -> np.ndarray:
        """Cycles since each neighbour's held pair was sent."""
        return content.held.ages

    def weights(self, place: Place, content: BeliefContent) -> np.ndarray | None:
        """Weights of the held shares (..., J) in the last round, volumes included."""
        # A function of beliefs and weights may do anything with them.
        return None if isinstance(self.average, Directly) else content.held.weights


def _with_own(ages: np.ndarray) -> np.ndarray:
    """Ages (..., 1 + J), the node's own first."""
    own = np.zeros((*ages.shape[:-1], 1), dtype=ages.dtype)
    return np.concatenate((own, ages), axis=-1)
