"""Consensus on beliefs in arrays: `concord.nodes.rules.belief_consensus` for all nodes of all runs
at once.

Held shares are kept in slots (`links.Links`), as the numbers that the rule averages. A share is
expressed in them once, and not by each node that hears it. Between the rounds of a step the own
beliefs stay such numbers too, where no caller asks for the beliefs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from concord.filters.filter import begun, moments
from concord.filters.fusion.averaging import INFORMATION, Averaging, near_sharpest
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import (
    Counters,
    LastPublished,
    LocalFilters,
    added,
    forgotten,
    nothing_published,
    traffic,
    with_lanes,
)
from concord.nodes.lanes.links import Links, Shares, unheard
from concord.nodes.lanes.mixing import Mixing, MixingWeights, mixed, summed
from concord.nodes.rules.belief_consensus import HoldPolicy
from concord.nodes.rules.local_filter import Memory, finite_lanes, predict_to_step, where
from concord.nodes.vector_codec import VectorCodec, belief_numbers, belief_of


class Numbers(NamedTuple):
    """Beliefs as the numbers (R, K, m) that a rule averages, and how sharp they are (R, K): NaN
    where one is not positive definite.

    `rounds` (K, K) is a product of rounds of which the values are still to be taken.
    """

    values: np.ndarray
    inverse_volume: np.ndarray
    rounds: np.ndarray | None = None

    def taken(self) -> "Numbers":
        """With the rounds taken."""
        if self.rounds is None:
            return self
        return Numbers(summed(self.rounds, self.values), self.inverse_volume)

    def in_slots(self, links: Links) -> "Numbers":
        """Those of nodes (R, N) in the order of slots (R, K)."""
        if links.perfect:
            return self
        return Numbers(self.values[:, links.source], self.inverse_volume[:, links.source])

    def refreshed(self, new: "Numbers", fresh: np.ndarray) -> "Numbers":
        """These, with the `new` ones where they are `fresh` (R, K)."""
        if fresh.all():
            return new
        return Numbers(
            np.where(fresh[..., None], new.values, self.values),
            np.where(fresh, new.inverse_volume, self.inverse_volume),
        )


class BatchedContent(NamedTuple):
    """Knowledge of all nodes in a step.

    belief: the own ones; within a step those before its rounds, where the rule is not `eager`.
    own, held: the own ones and what is held, by slot, about `origin` and `held_origin` (R, 1, n).
    ages: (R, E) by link, or (1, E) where they are those of all runs.
    memory: what the local filters have learnt, one entry for each group of sensors.
    """

    belief: Gaussian
    own: Numbers
    held: Numbers
    origin: np.ndarray
    held_origin: np.ndarray
    ages: np.ndarray
    published: LastPublished
    step: int
    control: np.ndarray | None
    cycles_in_step: int
    counters: Counters
    memory: tuple[Memory | None, ...] = ()


@dataclass(frozen=True)
class BatchedBeliefs:
    """All nodes of a network under a rule that averages beliefs, in so many rounds a step.

    `base` are the weights of one run; `contenders` (C,) the nodes that may ask for slots.
    """

    filters: LocalFilters
    averaging: Averaging
    hold: HoldPolicy
    links: Links
    base: Shares
    rounds: int
    contenders: np.ndarray
    codec: VectorCodec
    trigger: float

    @property
    def eager(self) -> bool:
        """Whether beliefs must be known after every round: for bids, the wire or a check."""
        lazy = self.averaging is INFORMATION and self.codec.exact
        return len(self.contenders) > 0 or not lazy

    def start(self, prior: Gaussian) -> BatchedContent:
        """The priors, and neighbours never heard."""
        prior = begun(self.filters.filter, prior)
        origin = prior.mean.mean(axis=1, keepdims=True)
        own, runs = self._expressed(prior, origin), len(prior.mean)
        nothing = np.broadcast_to(0.0, (runs, len(self.links.source), own.values.shape[-1]))
        nobody = Numbers(nothing, nothing[..., 0])
        ages = np.full((runs, len(self.links.sender)), -1)
        published = nothing_published(self.contenders, prior)
        return BatchedContent(prior, own, nobody, origin, origin, ages, published, 0, None, 0, {})

    def restarted(
        self, content: BatchedContent, nodes: np.ndarray, belief: Gaussian
    ) -> BatchedContent:
        """Let nodes begin anew, without the shares that they held of others."""
        return content._replace(
            belief=with_lanes(content.belief, nodes, begun(self.filters.filter, belief)),
            ages=unheard(self.links, content.ages, nodes),
            published=content.published.forgotten(nodes),
            memory=forgotten(self.filters, content.memory, nodes, self.links.nodes),
        )

    def begin_step(
        self, content: BatchedContent, readings: np.ndarray, control: np.ndarray | None, step: int
    ) -> BatchedContent:
        """Predict, take the own readings. Held shares follow once the silent nodes are known."""
        belief, published, counters = content.belief, content.published, content.counters
        if step > 0:
            belief, sound = self.filters.predict(belief, control, step)
            counters = added(counters, {"predict-failed": ~sound})
            if self.hold.carried:
                published = published.carried(self.filters, control, step)
        belief, memory, failures = self.filters.update(belief, readings, step, content.memory)
        own, origin = _about_a_middle(self._expressed, belief)
        return content._replace(
            belief=belief,
            own=own,
            origin=origin,
            published=published,
            step=step,
            control=control,
            cycles_in_step=0,
            counters=added(counters, failures),
            memory=memory,
        )

    def bids(self, content: BatchedContent, nodes: np.ndarray) -> np.ndarray:
        """How far beliefs have moved since they were last published."""
        return content.published.bids_of(nodes, content.belief, self.trigger)

    def exchange(
        self, content: BatchedContent, sends: np.ndarray, lost: np.ndarray | None
    ) -> BatchedContent:
        """Nodes `sends` (R, N) publish; all average what they hear and hold with their own."""
        shared, readable = self._shared(content)
        sound = readable & np.isfinite(shared.inverse_volume)
        counters = added(content.counters, self._traffic(sends, lost, readable, sound))
        fresh = self.links.in_slots(sends & sound, lost)
        held, ages = content.held, content.ages
        if fresh.all():
            ages = np.zeros((1, ages.shape[1]), dtype=ages.dtype)
        else:
            content = content._replace(own=content.own.taken(), held=held.taken())
            held, shared = content.held, shared.taken()
            if content.cycles_in_step == 0 and content.step > 0:
                held, ages = self._caught_up(content, fresh)
            ages = np.where(fresh[:, self.links.slot], 0, np.where(ages < 0, -1, ages + 1))
        content = content._replace(
            held=held.refreshed(shared.in_slots(self.links), fresh),
            held_origin=content.origin,
            ages=ages,
            published=content.published.sent(content.belief, sends),
            cycles_in_step=content.cycles_in_step + 1,
            counters=counters,
        )
        return self._settled(content, self._fused(content))

    def _fused(self, content: BatchedContent) -> Numbers:
        """Return the numbers after averaging at all nodes."""
        own, held = content.own, content.held
        mixing = self._weights.at(content.ages, content.cycles_in_step - 1)
        together = own is held and isinstance(mixing.whole, np.ndarray)
        if together and not (self.hold.by_inverse_volume or self.eager):
            # No caller needs the result of a single round.
            rounds = mixing.whole if own.rounds is None else mixing.whole @ own.rounds
            return own._replace(rounds=rounds)
        same, own = own is held, own.taken()
        held = own if same else held.taken()
        if not self.hold.by_inverse_volume:
            values = mixed(mixing, _usable(own, mixing, own.values), held.values)
            return Numbers(values, np.where(np.isfinite(values.sum(axis=-1)), 1.0, np.nan))
        # By weights w_j s_j, where w_j are those of all runs: sums of w_j s_j v_j over w_j s_j.
        heard = _times_inverse_volume(held)
        known = heard if same else _usable(own, mixing, _times_inverse_volume(own))
        sums = mixed(mixing, known, heard)
        return Numbers(sums[..., :-1] / sums[..., -1:], own.inverse_volume)

    @cached_property
    def _weights(self) -> MixingWeights:
        return MixingWeights(self.links, self.base, self.hold)

    def _settled(self, content: BatchedContent, fused: Numbers) -> BatchedContent:
        """With the fused beliefs where fusion went well."""
        belief, last = content.belief, content.cycles_in_step == self.rounds
        if self.eager or (self.hold.by_inverse_volume and not last):
            fused = fused._replace(inverse_volume=self.averaging.inverse_volume(fused.values))
        sound = np.isfinite(fused.inverse_volume)
        if self.eager or last:
            fused = fused.taken()
            after = self.averaging.from_numbers(fused.values, content.origin)
            sound = finite_lanes(after)
            belief = where(sound, after, belief)
        counters = added(content.counters, {"fuse-failed": ~sound})
        if not sound.all():
            fused = content.own.taken().refreshed(fused, sound)
        return content._replace(belief=belief, own=fused, counters=counters)

    def _shared(self, content: BatchedContent) -> tuple[Numbers, np.ndarray]:
        """Return the contents of the frames of all nodes, and which (R, N) can be read."""
        if self.codec.exact:
            return content.own, np.ones(content.own.inverse_volume.shape, dtype=bool)
        numbers = self.codec.received(belief_numbers(content.belief))
        belief = belief_of(numbers, content.belief.mean.shape[-1])
        return self._expressed(belief, content.origin), finite_lanes(belief)

    def _expressed(self, belief: Gaussian, origin: np.ndarray) -> Numbers:
        return Numbers(*self.averaging.to_numbers(belief, origin))

    def _caught_up(self, content: BatchedContent, fresh: np.ndarray) -> tuple[Numbers, np.ndarray]:
        """Return the held shares without a replacement now, at this step and about its origin."""
        held = content.held
        ages = np.broadcast_to(content.ages, (len(fresh), content.ages.shape[1]))
        known = np.zeros(fresh.shape, dtype=bool)
        known[:, self.links.slot] = ages >= 0
        runs, slots = np.nonzero(known & ~fresh)
        if not len(runs):
            return held, ages
        origin = content.held_origin[runs, 0]
        old = self.averaging.from_numbers(held.values[runs, slots], origin)
        if self.hold.carried:
            control = None if content.control is None else content.control[runs]
            filters = self.filters
            moved, sound = predict_to_step(
                old, control, content.step, filters.model, filters.filter
            )
            old = where(sound, moved, old)
            forgotten = np.zeros(fresh.shape, dtype=bool)
            forgotten[runs, slots] = ~sound
            ages = np.where(forgotten[:, self.links.slot], -1, ages)
        values, inverse_volume = held.values.copy(), held.inverse_volume.copy()
        now = self._expressed(old, content.origin[runs, 0])
        values[runs, slots], inverse_volume[runs, slots] = now.values, now.inverse_volume
        return Numbers(values, inverse_volume), ages

    def _traffic(
        self, sends: np.ndarray, lost: np.ndarray | None, readable: np.ndarray, sound: np.ndarray
    ) -> dict[str, np.ndarray]:
        counts = traffic(self.links, sends & readable, sends & ~readable, lost, "belief-not-finite")
        if sound.all():
            return counts
        unsound = self.links.arriving(sends & readable & ~sound, lost)
        refused = {"rejected not-positive-definite": self.links.per_receiver(unsound)}
        return {**counts, **refused}

    def belief(self, content: BatchedContent) -> Gaussian:
        """The own pairs, after the last round of a step."""
        return moments(self.filters.filter, content.belief)

    def ages(self, content: BatchedContent) -> np.ndarray:
        """Cycles since the held pairs were sent."""
        return np.broadcast_to(content.ages, (len(content.origin), content.ages.shape[1]))

    def counters(self, content: BatchedContent) -> Counters:
        """Return the totals."""
        return content.counters

    def spread(self, content: BatchedContent) -> None:
        """Shares have one length."""


def _about_a_middle(
    express: Callable[[Gaussian, np.ndarray], Numbers], belief: Gaussian
) -> tuple[Numbers, np.ndarray]:
    """The numbers of beliefs (R, N, n), and their origin (R, 1, n): the mean of all, or of a node
    that is far sharper than others."""
    middle = belief.mean.mean(axis=1, keepdims=True)
    numbers = express(belief, middle)
    least = np.nan_to_num(numbers.inverse_volume, nan=np.inf).min(axis=1, keepdims=True)
    sharp = np.concatenate((least, numbers.inverse_volume), axis=1)
    origin = near_sharpest(np.concatenate((middle, belief.mean), axis=1), sharp)[:, None]
    return (numbers, middle) if (origin == middle).all() else (express(belief, origin), origin)


def _usable(own: Numbers, mixing: Mixing, values: np.ndarray) -> np.ndarray:
    """Values of the own numbers, 0 where they are of no belief and weigh nothing."""
    unsound = np.isnan(own.inverse_volume)
    if not unsound.any():
        return values
    # 0 * NaN would let them through.
    return np.where((unsound & (mixing.own == 0))[..., None], 0.0, values)


def _times_inverse_volume(numbers: Numbers) -> np.ndarray:
    """Numbers times their inverse volume, and that volume: (R, K, m + 1), lanes last in memory."""
    runs, slots, m = numbers.values.shape
    product = np.empty((m + 1, runs, slots)).transpose(1, 2, 0)
    np.multiply(numbers.values, numbers.inverse_volume[..., None], out=product[..., :-1])
    product[..., -1] = numbers.inverse_volume
    return product
