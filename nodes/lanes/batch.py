"""A fusion rule at all nodes of many runs: lanes (R, N), with held values (R, E), one a link.

The functions are those of a node (`concord.nodes.rules.lane_rule`). Only `fuse` looks at a
neighbourhood: it is called for nodes of about as many neighbours at once (`links.DegreeClass`),
with places that one lacks filled up as neighbours that were never heard.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, NamedTuple, cast

import numpy as np

from concord.filters.filter import begun, moments
from concord.filters.fusion.hold import renormalise
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import Counters, added, forgotten, traffic, with_lanes
from concord.nodes.lanes.links import DegreeClass, Links, Shares
from concord.nodes.lanes.mixing import mixed, weighed
from concord.nodes.rules.fresh_consensus import FreshConsensus, FreshOwn, LastUsed
from concord.nodes.rules.information_rounds import InformationRounds
from concord.nodes.rules.lane_rule import (
    Held,
    LaneContent,
    LaneRule,
    LocalStep,
    Own,
    Place,
    Share,
    mapped,
)
from concord.nodes.rules.local_filter import LocalFilters
from concord.nodes.vector_codec import VectorCodec


class BatchContent(NamedTuple, Generic[Own, Held]):
    """Knowledge of all nodes, and the counters."""

    known: LaneContent[Own, Held]
    counters: Counters


@dataclass(frozen=True)
class InBatch(Generic[Own, Held, Share]):
    """A rule at all nodes of a network (`concord.nodes.lanes.network.BatchedRule`).

    `base` are the weights of one run; `codec` is that of a node.
    """

    rule: LaneRule[Own, Held, Share]
    filters: LocalFilters
    links: Links
    base: Shares
    codec: VectorCodec

    @property
    def _nodes(self) -> np.ndarray:
        return np.arange(self.links.nodes)

    def start(self, prior: Gaussian) -> BatchContent[Own, Held]:
        """The priors, and neighbours never heard."""
        prior, receiver = begun(self.filters.filter, prior), self.links.receiver
        held = Gaussian(prior.mean[:, receiver], prior.cov[:, receiver])
        return BatchContent(self.rule.start(self._nodes, prior, held), {})

    def restarted(
        self, content: BatchContent[Own, Held], nodes: np.ndarray, belief: Gaussian
    ) -> BatchContent[Own, Held]:
        """Nodes begin anew with these beliefs, and have heard no neighbour."""
        known = content.known
        anew = self.start(with_lanes(self.belief(content), nodes, belief)).known
        heard = np.flatnonzero(np.isin(self.links.receiver, nodes))
        own = mapped(lambda old, new: _replaced(old, nodes, new[:, nodes]), known.own, anew.own)
        held = mapped(lambda old, new: _replaced(old, heard, new[:, heard]), known.held, anew.held)
        memory = forgotten(self.filters, known.memory, nodes, self.links.nodes)
        return content._replace(known=known._replace(own=own, held=held, memory=memory))

    def begin_step(
        self,
        content: BatchContent[Own, Held],
        readings: np.ndarray,
        control: np.ndarray | None,
        step: int,
    ) -> BatchContent[Own, Held]:
        """Carry everything to this step and take the own readings."""
        driven = None if control is None else control[:, None, :]
        now = LocalStep(self.filters, readings, driven, step)
        known, failures = self.rule.begin_step(self._nodes, content.known, now)
        return BatchContent(known, added(content.counters, failures))

    def bids(self, content: BatchContent[Own, Held], nodes: np.ndarray) -> np.ndarray:
        """How urgent a dynamic slot is to these nodes (C,): integers (R, C)."""
        return self.rule.bid(content.known)[:, nodes]

    def exchange(
        self, content: BatchContent[Own, Held], sends: np.ndarray, lost: np.ndarray | None
    ) -> BatchContent[Own, Held]:
        """A round: nodes `sends` (R, N) share, and all fuse what they hear."""
        rule, links, known = self.rule, self.links, content.known
        numbers = self.codec.received(rule.say(known))
        readable = np.isfinite(numbers).all(axis=-1)
        sent = sends & readable
        # A node that says nothing is not read: its numbers may be anything.
        shares, sound, reason = rule.read(np.where(sent[..., None], numbers, 0.0))
        counted = traffic(links, sent, sends & ~readable, lost, f"{self.codec.what}-not-finite")
        if sound is not None:
            refused = links.arriving(sent & ~sound, lost)
            counted = {**counted, f"rejected {reason}": links.per_receiver(refused)}
            sent = sent & sound
        came = links.arriving(sent, lost)
        counters = added(content.counters, counted)
        known, failures = self._fused(rule.sent(known, sends), shares, came)
        return BatchContent(known, added(counters, failures))

    def _fused(
        self, before: LaneContent[Own, Held], shares: Share, came: np.ndarray
    ) -> tuple[LaneContent[Own, Held], Mapping[str, np.ndarray]]:
        """All neighbourhoods, class by class; `came` (R, E) says which shares did."""
        own, held, after = before.own, before.held, before
        failures: dict[str, np.ndarray] = {}
        for some, weights in zip(self.links.classes, self.links.rows(self.base), strict=True):
            heard = some.gathered(came, False)
            mine = mapped(lambda values, some=some: values[:, some.nodes], before.own)
            theirs = mapped(lambda values, some=some: _gathered(some, values), before.held)
            senders = self.links.sender[some.links]
            words = mapped(lambda values, senders=senders: values[:, senders], shares)
            after, failed = self.rule.fuse(
                Place(some.nodes, weights[0]),
                LaneContent(mine, theirs, before.cycles_in_step),
                words,
                heard,
            )
            own = mapped(lambda a, b, some=some: _replaced(a, some.nodes, b), own, after.own)
            held = mapped(
                lambda a, b, some=some: _replaced(a, some.links[some.real], b[:, some.real]),
                held,
                after.held,
            )
            for name, count in failed.items():
                total = failures.setdefault(name, np.zeros((*came.shape[:1], self.links.nodes)))
                total[:, some.nodes] += count
        after = LaneContent(own, held, after.cycles_in_step, before.memory)
        return after, failures

    def belief(self, content: BatchContent[Own, Held]) -> Gaussian:
        """Return the current beliefs of the nodes: (R, N, n), (R, N, n, n)."""
        return moments(self.filters.filter, self.rule.belief(content.known))

    def ages(self, content: BatchContent[Own, Held]) -> np.ndarray:
        """Cycles since what came over each link was sent (R, E); -1 is never."""
        return self.rule.ages(content.known)

    def counters(self, content: BatchContent[Own, Held]) -> Counters:
        """Return the totals since the start."""
        return content.counters

    def spread(self, content: BatchContent[Own, Held]) -> None:
        """Shares have one length."""
        return


class AveragesInBatch(InBatch[FreshOwn, LastUsed, np.ndarray]):
    """`InBatch` of rules whose rounds are averages of numbers (`InformationRounds`).

    All averages are one product with a matrix of weights. That takes 1.5 to 2 times less of a Monte
    Carlo than averages of gathered neighbourhoods (docs/decisions.md).
    """

    def _fused(
        self, before: LaneContent[FreshOwn, LastUsed], shares: np.ndarray, came: np.ndarray
    ) -> tuple[LaneContent[FreshOwn, LastUsed], Mapping[str, np.ndarray]]:
        rule = cast(FreshConsensus, self.rule)
        exchange = cast(InformationRounds, rule.exchange)
        ages = np.where(came[:1] if came.all() else came, 0, -1)
        mixing = weighed(self.links, self.base, ages, renormalise)
        # A share that was not heard has no weight, and its numbers are finite.
        known = mixed(mixing, before.own.known, shares[:, self.links.source])
        return rule.settled(before, known, exchange.from_information(known), came)


def _replaced(values: np.ndarray, places: np.ndarray, replacing: np.ndarray) -> np.ndarray:
    """Values (R, N, ...) with those of some places (J,) replaced by (R, J, ...)."""
    if len(places) == values.shape[1] and (places == np.arange(len(places))).all():
        return replacing
    changed = values.copy()
    changed[:, places] = replacing
    return changed


def _gathered(some: DegreeClass, values: np.ndarray) -> np.ndarray:
    """Return held values (R, E, ...) as (R, K, J, ...).

    Places without a neighbour are padded: ages are -1, flags False, and numbers those of another.
    """
    if values.dtype == bool:
        return some.gathered(values, False)
    return some.gathered(values, -1) if values.dtype.kind == "i" else values[:, some.links]
