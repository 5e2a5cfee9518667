"""Consensus on beliefs in arrays: `nodes.belief_consensus` for all nodes of all runs at once.

What is held of others is kept in slots (`vectorised_links.Links`). What a node shares is expressed
in the numbers that the rule averages once, and not by each who hears it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from filters.fusion import Averaging
from filters.gaussian import Gaussian
from filters.linalg import cholesky, symmetrise
from nodes.belief_consensus import HoldPolicy, alike
from nodes.local_filter import carry, finite_lanes, where
from nodes.messages import Array
from nodes.vectorised_filter import (
    Counters,
    LocalFilters,
    Published,
    added,
    nothing_published,
    received,
    traffic,
)
from nodes.vectorised_links import Links, Shares, mixed, weighed


class Expressed(NamedTuple):
    """Beliefs (R, K, n), the numbers (R, K, m) that the rule averages, and sharpness (R, K)."""

    belief: Gaussian
    numbers: Array
    sharpness: Array


class Content(NamedTuple):
    """What all nodes know. `held` is by slot, `ages` by link; `origin` (R, 1, n) is what means are
    taken about in this step; `carried` says whether what is held has come to this step."""

    belief: Gaussian
    held: Expressed
    ages: np.ndarray
    published: Published
    origin: Array
    step: int
    control: Array | None
    cycles_in_step: int
    counters: Counters


@dataclass(frozen=True)
class BeliefFleet:
    """All nodes of a network under a rule that averages beliefs; None averages nothing.

    `base` are the weights of one run; `contenders` (C,) whoever may ask for the dynamic segment.
    """

    filters: LocalFilters
    averaging: Averaging | None
    hold: HoldPolicy
    links: Links
    base: Shares
    contenders: np.ndarray
    number: str
    trigger: float

    def start(self, prior: Gaussian) -> Content:
        """The priors, and neighbours never heard."""
        origin = prior.mean.mean(axis=1, keepdims=True)
        source = self.links.source
        unheard = Gaussian(prior.mean[:, source], prior.cov[:, source])
        held = Expressed(unheard, *self._expressed(unheard, origin))
        ages = np.full((len(prior.mean), len(self.links.sender)), -1)
        published = nothing_published(self.contenders, prior)
        return Content(prior, held, ages, published, origin, 0, None, 0, {})

    def begin_step(
        self, content: Content, readings: Array, control: Array | None, step: int
    ) -> Content:
        """Predict, take the own readings. What is held follows once it is known who is silent."""
        belief, published, counters = content.belief, content.published, content.counters
        if step > 0:
            belief, sound = self.filters.carry(belief, control, step)
            counters = added(counters, {"predict-failed": ~sound})
            if self.hold.carried:
                published = published.carried(self.filters, control, step)
        belief, troubles = self.filters.take(belief, readings, step)
        return content._replace(
            belief=belief,
            published=published,
            origin=belief.mean.mean(axis=1, keepdims=True),
            step=step,
            control=control,
            cycles_in_step=0,
            counters=added(counters, troubles),
        )

    def bids(self, content: Content, nodes: np.ndarray) -> np.ndarray:
        """How far beliefs have moved since they were last published."""
        return content.published.bids_of(nodes, content.belief, self.trigger)

    def exchange(self, content: Content, sends: np.ndarray, lost: np.ndarray | None) -> Content:
        """Nodes `sends` (R, N) publish; all average what they hear and hold with their own."""
        own = Expressed(content.belief, *self._expressed(content.belief, content.origin))
        shared = self._shared(own, content.origin)
        readable = finite_lanes(shared.belief)
        sound = readable & np.isfinite(cholesky(shared.belief.cov)[..., -1, -1])
        counters = added(content.counters, self._traffic(sends, lost, readable, sound))
        fresh = self.links.in_slots(sends & sound, lost)
        held, ages = content.held, content.ages
        if content.cycles_in_step == 0 and content.step > 0:
            held, ages = self._caught_up(content, fresh)
        held = self._refreshed(held, shared, fresh)
        older = np.where(ages < 0, -1, ages + 1)
        content = content._replace(
            held=held,
            ages=np.where(fresh[:, self.links.slot], 0, older),
            published=content.published.sent(content.belief, sends),
            cycles_in_step=content.cycles_in_step + 1,
            counters=counters,
        )
        return content if self.averaging is None else self._fused(content, own, self.averaging)

    def _fused(self, content: Content, own: Expressed, averaging: Averaging) -> Content:
        held = content.held
        turn = content.cycles_in_step - 1
        sharpness = Shares(own.sharpness, held.sharpness[:, self.links.slot])
        weights = weighed(
            self.links,
            self.base,
            content.ages,
            None if self.hold.sharpness is alike else sharpness,
            lambda base, ages, sharpness: self.hold.weigh(base, ages, sharpness, turn),
        )
        numbers = np.where(weights.own[..., None] == 0, 0.0, own.numbers)
        fused = averaging.conclude(
            mixed(self.links, weights, numbers, held.numbers), content.origin
        )
        sound = finite_lanes(fused)
        counters = added(content.counters, {"fuse-failed": ~sound})
        fused = Gaussian(fused.mean, symmetrise(fused.cov))
        return content._replace(belief=where(sound, fused, content.belief), counters=counters)

    def _shared(self, own: Expressed, origin: Array) -> Expressed:
        """What comes out of the frames of all nodes."""
        if self.number == "<f8":
            return own
        belief = Gaussian(*(received(values, self.number) for values in own.belief))
        return Expressed(belief, *self._expressed(belief, origin))

    def _expressed(self, belief: Gaussian, origin: Array) -> tuple[Array, Array]:
        if self.averaging is None:
            return np.zeros((*belief.mean.shape[:-1], 0)), np.ones(belief.mean.shape[:-1])
        return self.averaging.express(belief, origin), self.hold.sharpness(belief.cov)

    def _caught_up(self, content: Content, fresh: np.ndarray) -> tuple[Expressed, np.ndarray]:
        """What is held of those who do not replace it now, at this step and about its origin."""
        held, ages = content.held, content.ages
        known = np.zeros(fresh.shape, dtype=bool)
        known[:, self.links.slot] = ages >= 0
        runs, slots = np.nonzero(known & ~fresh)
        if not len(runs):
            return held, ages
        old = Gaussian(held.belief.mean[runs, slots], held.belief.cov[runs, slots])
        if self.hold.carried:
            control = None if content.control is None else content.control[runs]
            filters = self.filters
            moved, sound = carry(old, control, content.step, filters.model, filters.points)
            old = where(sound, moved, old)
            lost = np.zeros(fresh.shape, dtype=bool)
            lost[runs, slots] = ~sound
            ages = np.where(lost[:, self.links.slot], -1, ages)
        numbers, sharpness = self._expressed(old, content.origin[runs, 0])
        mean, cov = held.belief.mean.copy(), held.belief.cov.copy()
        every, sharp = held.numbers.copy(), held.sharpness.copy()
        mean[runs, slots], cov[runs, slots] = old
        every[runs, slots], sharp[runs, slots] = numbers, sharpness
        return Expressed(Gaussian(mean, cov), every, sharp), ages

    def _refreshed(self, held: Expressed, shared: Expressed, fresh: np.ndarray) -> Expressed:
        """What is held after those slots that are `fresh` (R, K) have been filled."""
        source = self.links.source
        if not self.links.perfect:
            belief = Gaussian(shared.belief.mean[:, source], shared.belief.cov[:, source])
            shared = Expressed(belief, shared.numbers[:, source], shared.sharpness[:, source])
        if fresh.all():
            return shared
        return Expressed(
            where(fresh, shared.belief, held.belief),
            np.where(fresh[..., None], shared.numbers, held.numbers),
            np.where(fresh, shared.sharpness, held.sharpness),
        )

    def _traffic(
        self, sends: np.ndarray, lost: np.ndarray | None, readable: np.ndarray, sound: np.ndarray
    ) -> dict[str, np.ndarray]:
        heard = traffic(self.links, sends & readable, sends & ~readable, lost, "belief-not-finite")
        unsound = self.links.arriving(sends & readable & ~sound, lost)
        refused = {"rejected not-positive-definite": self.links.per_receiver(unsound)}
        return {**heard, **refused}

    def belief(self, content: Content) -> Gaussian:
        """The own pairs."""
        return content.belief

    def ages(self, content: Content) -> np.ndarray:
        """Cycles since the held pairs were sent."""
        return content.ages

    def counters(self, content: Content) -> Counters:
        """What was counted."""
        return content.counters
