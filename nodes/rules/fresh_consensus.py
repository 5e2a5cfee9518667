"""Consensus on fresh shares alone: rules that use what was heard in a round, and hold nothing.

Nodes exchange content that is made of this step's readings. Held over into the next step it would
bring the same readings again, as if they were new.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from concord.filters.fusion.hold import renormalise
from concord.filters.gaussian import Gaussian
from concord.filters.linalg import cholesky, symmetrise
from concord.filters.turns import Angles, turns_between, turns_to_own
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.lane_rule import (
    Failures,
    LaneContent,
    LocalStep,
    Place,
    Published,
    nothing_published,
    older,
)
from concord.nodes.rules.local_filter import finite_lanes, where


class Exchange(Protocol):
    """Content that nodes exchange: vectors of numbers (..., m), one of each lane.

    `cycle` counts the communication cycles in a step from 0; `prior` is the belief before the
    node's own readings of the step.
    """

    def begin(self, node: np.ndarray, prior: Gaussian, posterior: Gaussian) -> np.ndarray:
        """What nodes (...) know (..., m) after their own readings."""
        ...

    def say(self, cycle: int, known: np.ndarray, belief: Gaussian) -> np.ndarray:
        """Return the content to share (..., m) in a round."""
        ...

    def placed(self, cycle: int, shares: np.ndarray, states: int) -> tuple[np.ndarray, np.ndarray]:
        """Means (..., n) about which shares (..., m) of a round are, and their variances."""
        ...

    def turned(self, cycle: int, shares: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Shares (..., m) of a round on turns (..., n) in rad away."""
        ...

    def sound(self, shares: np.ndarray) -> np.ndarray:
        """Which of shares (..., m) any node can use: (...) bool; False where one is NaN."""
        ...

    def usable(self, prior: Gaussian, shares: np.ndarray) -> np.ndarray | None:
        """Which of shares (..., J, m) can be used beside the own prior: (..., J) bool; None for a
        rule to which the prior does not matter."""
        ...

    def fuse(
        self,
        cycle: int,
        weights: np.ndarray,
        prior: Gaussian,
        known: np.ndarray,
        belief: Gaussian,
        shares: np.ndarray,
    ) -> tuple[np.ndarray, Gaussian]:
        """Return the content (..., m) and the belief after a round.

        Shares (..., 1 + J, m) are the node's own and those of its neighbours, NaN where nothing
        came; so are the weights (..., 1 + J). A belief that is not finite, or not positive
        definite, says that it went wrong.
        """
        ...


class FreshOwn(NamedTuple):
    """A node's knowledge: beliefs before and after the readings of the step (..., n), and what it
    shares (..., m)."""

    prior: Gaussian
    belief: Gaussian
    known: np.ndarray
    published: Published


class LastUsed(NamedTuple):
    """Cycles since a share of each neighbour was used (..., J), -1 for never."""

    ages: np.ndarray


FreshContent = LaneContent[FreshOwn, LastUsed]


@dataclass(frozen=True)
class FreshConsensus:
    """The rules that exchange fresh shares, as a `LaneRule`; `angles` as in `BeliefConsensus`.

    Nodes exchange numbers of states about the `origin` (n,), which all know; None for zero.
    """

    exchange: Exchange
    trigger: float = 0.0
    contends: bool = True
    origin: np.ndarray | None = None
    angles: Angles = ()

    def _about(self, belief: Gaussian) -> Gaussian:
        """The belief about the origin, which keeps the digits of the information's vector."""
        return belief if self.origin is None else belief._replace(mean=belief.mean - self.origin)

    def start(self, node: np.ndarray, prior: Gaussian, held: Gaussian) -> FreshContent:
        """The prior, and neighbours never heard."""
        known = self.exchange.begin(node, self._about(prior), self._about(prior))
        own = FreshOwn(prior, prior, known, nothing_published(prior))
        return LaneContent(own, LastUsed(np.full(held.mean.shape[:-1], -1)), 0)

    def begin_step(
        self, node: np.ndarray, content: FreshContent, now: LocalStep
    ) -> tuple[FreshContent, Failures]:
        """Predict, then take the own readings one by one."""
        prior, published = content.own.belief, content.own.published
        failures: dict[str, np.ndarray] = {}
        if now.step > 0:
            (moved, sound), *others = now.predict(*(prior, published.belief)[: 1 + self.contends])
            prior = where(sound, moved, prior)
            failures = {} if sound.all() else {"predict-failed": ~sound}
            if others:
                published = published.moved(others[0])
        belief, memory, failed = now.update(prior, content.memory)
        known = self.exchange.begin(node, self._about(prior), self._about(belief))
        own = FreshOwn(prior, belief, known, published)
        return LaneContent(own, content.held, 0, memory), {**failures, **failed}

    def bid(self, content: FreshContent) -> np.ndarray:
        """How far the belief has moved since it was last published."""
        return content.own.published.bid(content.own.belief, self.trigger)

    def say(self, content: FreshContent) -> np.ndarray:
        """Return the content to share in this round."""
        share = self._own(content)
        if not self.angles:
            return share
        cycle = content.cycles_in_step
        mean, _ = self.exchange.placed(cycle, share, content.own.belief.mean.shape[-1])
        turns = turns_between(mean, np.zeros_like(mean), self.angles)
        return self.exchange.turned(cycle, share, turns)

    def _own(self, content: FreshContent) -> np.ndarray:
        belief = self._about(content.own.belief)
        return self.exchange.say(content.cycles_in_step, content.own.known, belief)

    def sent(self, content: FreshContent, sends: np.ndarray) -> FreshContent:
        """The node remembers what it believed then."""
        own = content.own
        if not self.contends:
            return content
        published = own.published.sent(own.belief, sends)
        return content._replace(own=own._replace(published=published))

    def read(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, str]:
        """The numbers themselves."""
        return numbers, self.exchange.sound(numbers), "unsound"

    def fuse(
        self, place: Place, content: FreshContent, shares: np.ndarray, heard: np.ndarray
    ) -> tuple[FreshContent, Failures]:
        """One round of the rule with what was heard, in sender order."""
        own, _, cycle, _ = content
        failures: dict[str, np.ndarray] = {}
        prior, belief = self._about(own.prior), self._about(own.belief)
        usable = self.exchange.usable(prior, np.where(heard[..., None], shares, 0.0))
        if usable is not None and (refused := heard & ~usable).any():
            failures = {"rejected unsound": refused.sum(axis=-1)}
            heard = heard & usable
        everyone = np.concatenate(
            (self._own(content)[..., None, :], np.where(heard[..., None], shares, np.nan)), axis=-2
        )
        if self.angles:
            placed = self.exchange.placed(cycle, everyone, own.belief.mean.shape[-1])
            turns = turns_to_own(*placed, place.weights, self.angles)
            everyone = self.exchange.turned(cycle, everyone, turns)
        known, belief = self.exchange.fuse(cycle, place.weights, prior, own.known, belief, everyone)
        content, failed = self.settled(content, known, belief, heard)
        return content, {**failures, **failed}

    def settled(
        self, content: FreshContent, known: np.ndarray, belief: Gaussian, heard: np.ndarray
    ) -> tuple[FreshContent, Failures]:
        """The content after a round that came to this about the origin, where it is a belief;
        `heard` as in `fuse`, or (R, E) of links."""
        own, (ages,), cycle, _ = content
        mean = belief.mean if self.origin is None else belief.mean + self.origin
        belief = Gaussian(mean, symmetrise(belief.cov))
        sound = believable(belief)
        own = own._replace(
            belief=where(sound, belief, own.belief),
            known=known if sound.all() else np.where(sound[..., None], known, own.known),
        )
        failures = {} if sound.all() else {"fuse-failed": ~sound}
        used = LastUsed(np.where(heard, 0, older(ages)))
        return content._replace(own=own, held=used, cycles_in_step=cycle + 1), failures

    def belief(self, content: FreshContent) -> Gaussian:
        """Return the rule's belief from all shares heard so far in this step."""
        return content.own.belief

    def ages(self, content: FreshContent) -> np.ndarray:
        """Cycles since a share of each neighbour was last used."""
        return content.held.ages

    def weights(self, place: Place, content: FreshContent) -> np.ndarray | None:
        """Weights (..., J) of the shares of the last round, where a round is their average."""
        if not isinstance(self.exchange, InformationRounds):
            return None
        ages = content.held.ages
        own = np.zeros((*ages.shape[:-1], 1), dtype=ages.dtype)
        return renormalise(place.weights, np.concatenate((own, ages), axis=-1))[..., 1:]


def believable(belief: Gaussian) -> np.ndarray:
    """Whether beliefs (..., n) that a rule came to are finite and positive definite: (...) bool."""
    # Numbers near the largest that there are can leave a covariance of zero.
    definite = np.logical_not(np.isnan(cholesky(belief.cov)[..., 0, 0]))
    return np.logical_and(finite_lanes(belief), definite)
