"""Consensus on fresh shares in arrays: `nodes.fresh_consensus` at all nodes of all runs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from filters.gaussian import Gaussian
from filters.hold import renormalise
from filters.linalg import symmetrise
from nodes.fresh_consensus import believable
from nodes.local_filter import where
from nodes.messages import Array
from nodes.novelty_rounds import NoveltyRounds
from nodes.vectorised_filter import (
    Counters,
    LocalFilters,
    Published,
    added,
    nothing_published,
    received,
    traffic,
    with_lanes,
)
from nodes.vectorised_links import Links, Shares, unheard
from nodes.vectorised_mixing import mixed, weighed


class Turn(NamedTuple):
    """What all nodes know in a round: `cycle` of the step, from 0; known (R, N, m).

    `shares` (R, N, m) are what came out of the frames of those nodes that `sent` (R, N) some;
    `lost` (R, E) as `Links.arriving` has it.
    """

    cycle: int
    prior: Gaussian
    known: Array
    belief: Gaussian
    shares: Array
    sent: np.ndarray
    lost: np.ndarray | None


class Outcome(NamedTuple):
    """What is known (R, N, m) and believed after a round; `used` and `refused` (R, E) say what
    became of the shares that came over each link."""

    known: Array
    belief: Gaussian
    used: np.ndarray
    refused: np.ndarray


class FreshExchange(Protocol):
    """A rule of `fresh_consensus.FreshRule` at all nodes."""

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What nodes know (R, N, m) after their own readings."""
        ...

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """What they share (R, N, m) in a round."""
        ...

    def hear(self, turn: Turn) -> Outcome:
        """A round."""
        ...


class InformationExchange(NamedTuple):
    """`information_rounds.InformationRounds` at all nodes: averages of what was heard.

    A share is sound or not by itself, so it is looked at once and not by each who hears it.
    """

    open: Callable[[Gaussian, Gaussian], Array]
    conclude: Callable[[Array], Gaussian]
    check: Callable[[Array], np.ndarray]
    links: Links
    base: Shares

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What the rule averages."""
        return self.open(prior, posterior)

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """All that is known."""
        return known

    def hear(self, turn: Turn) -> Outcome:
        """The averages, and the beliefs that they come to."""
        links = self.links
        sound = self.check(np.where(turn.sent[..., None], turn.shares, 0.0))
        used = links.arriving(turn.sent & sound, turn.lost)
        fresh = links.in_slots(turn.sent & sound, turn.lost)
        ages = np.where(used[:1] if used.all() else used, 0, -1)
        mixing = weighed(links, self.base, ages, renormalise)
        held = np.where(fresh[..., None], turn.shares[:, links.source], 0.0)
        numbers = mixed(mixing, turn.known, held)
        refused = links.arriving(turn.sent & ~sound, turn.lost)
        return Outcome(numbers, self.conclude(numbers), used, refused)


class NoveltyExchange(NamedTuple):
    """`novelty_rounds.NoveltyRounds` at all nodes: one such rule for each class of degrees."""

    rules: tuple[NoveltyRounds, ...]
    links: Links

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What nodes say in the first round."""
        return self.rules[0].begin(prior, posterior)

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """First what the own readings brought, then the mean, padded."""
        return self.rules[0].say(cycle, known, belief)

    def hear(self, turn: Turn) -> Outcome:
        """Each node with what its neighbourhood says."""
        links = self.links
        came = links.arriving(turn.sent, turn.lost)
        used = np.zeros_like(came)
        mean, cov = turn.belief.mean.copy(), turn.belief.cov.copy()
        said = self.say(turn.cycle, turn.known, turn.belief)
        for some, rule in zip(links.classes, self.rules, strict=True):
            nodes = some.nodes
            prior, belief = (
                Gaussian(one.mean[:, nodes], one.cov[:, nodes]) for one in (turn.prior, turn.belief)
            )
            here = some.gathered(came, False)
            shares = np.where(here[..., None], turn.shares[:, links.sender[some.links]], 0.0)
            here = here & rule.sound(prior, shares)
            everyone = np.concatenate(
                (said[:, nodes, None], np.where(here[..., None], shares, np.nan)), axis=-2
            )
            _, after = rule.fuse(turn.cycle, prior, turn.known[:, nodes], belief, everyone)
            mean[:, nodes], cov[:, nodes] = after
            used[:, some.links[some.real]] = here[:, some.real]
        return Outcome(turn.known, Gaussian(mean, cov), used, came & ~used)


class Content(NamedTuple):
    """What all nodes know: (R, N, ...); `ages` (R, E) by link."""

    prior: Gaussian
    belief: Gaussian
    known: Array
    ages: np.ndarray
    published: Published
    cycles_in_step: int
    counters: Counters


@dataclass(frozen=True)
class FreshFleet:
    """All nodes of a network under such a rule; `contenders` (C,) may ask for dynamic slots."""

    filters: LocalFilters
    rule: FreshExchange
    links: Links
    contenders: np.ndarray
    number: str
    trigger: float

    def start(self, prior: Gaussian) -> Content:
        """The priors, and neighbours never heard."""
        ages = np.full((len(prior.mean), len(self.links.sender)), -1)
        known = self.rule.begin(prior, prior)
        return Content(prior, prior, known, ages, nothing_published(self.contenders, prior), 0, {})

    def restarted(self, content: Content, nodes: np.ndarray, belief: Gaussian) -> Content:
        """Nodes begin anew, and have heard nobody."""
        return content._replace(
            belief=with_lanes(content.belief, nodes, belief),
            ages=unheard(self.links, content.ages, nodes),
            published=content.published.forgotten(nodes),
        )

    def begin_step(
        self, content: Content, readings: Array, control: Array | None, step: int
    ) -> Content:
        """Predict, then take the own readings."""
        prior, published, counters = content.belief, content.published, content.counters
        if step > 0:
            prior, sound = self.filters.carry(prior, control, step)
            counters = added(counters, {"predict-failed": ~sound})
            published = published.carried(self.filters, control, step)
        belief, troubles = self.filters.take(prior, readings, step)
        known = self.rule.begin(prior, belief)
        counters = added(counters, troubles)
        return Content(prior, belief, known, content.ages, published, 0, counters)

    def bids(self, content: Content, nodes: np.ndarray) -> np.ndarray:
        """How far beliefs have moved since they were last published."""
        return content.published.bids_of(nodes, content.belief, self.trigger)

    def exchange(self, content: Content, sends: np.ndarray, lost: np.ndarray | None) -> Content:
        """One round of the rule among those who hear each other."""
        cycle = content.cycles_in_step
        prior, belief, known = content.prior, content.belief, content.known
        shares = received(self.rule.say(cycle, known, belief), self.number)
        readable = np.isfinite(shares).all(axis=-1)
        sent = sends & readable
        outcome = self.rule.hear(Turn(cycle, prior, known, belief, shares, sent, lost))
        counters = added(
            content.counters,
            traffic(self.links, sent, sends & ~readable, lost, "share-not-finite"),
        )
        refused = {"rejected unsound": self.links.per_receiver(outcome.refused)}
        belief = Gaussian(outcome.belief.mean, symmetrise(outcome.belief.cov))
        sound = believable(belief)
        older = np.where(content.ages < 0, -1, content.ages + 1)
        return Content(
            prior=content.prior,
            belief=where(sound, belief, content.belief),
            known=np.where(sound[..., None], outcome.known, content.known),
            ages=np.where(outcome.used, 0, older),
            published=content.published.sent(content.belief, sends),
            cycles_in_step=cycle + 1,
            counters=added(counters, {**refused, "fuse-failed": ~sound}),
        )

    def belief(self, content: Content) -> Gaussian:
        """What the rule makes of all that was heard so far in this step."""
        return content.belief

    def ages(self, content: Content) -> np.ndarray:
        """Cycles since a share over each link was last used."""
        return content.ages

    def counters(self, content: Content) -> Counters:
        """What was counted."""
        return content.counters

    def spread(self, content: Content) -> None:
        """Shares have one length."""
        return
