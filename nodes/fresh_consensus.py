"""Consensus on fresh shares alone: rules that use what was heard in a round, and hold nothing.

What they exchange is made of this step's readings. Held over into the next step it would bring the
same readings again, as if they were new.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, symmetrise
from filters.sigma_points import SigmaPointRule
from nodes.bids import FIRST_BID, asked, bid_for_change
from nodes.local_filter import (
    Model,
    Sensor,
    at,
    carry,
    control_of,
    finite_lanes,
    stacked,
    take_own,
)
from nodes.messages import Array, Measured
from nodes.vector_codec import VectorCodec


class FreshRule(Protocol):
    """A fusion rule whose shares are vectors of numbers (m,).

    `cycle` counts the communication cycles in a step from 0; `prior` is the belief before the
    node's own readings of the step.
    """

    def begin(self, prior: Gaussian, posterior: Gaussian) -> Array:
        """What a node knows (m,) after its own readings."""
        ...

    def say(self, cycle: int, known: Array, belief: Gaussian) -> Array:
        """What it shares (m,) in a round."""
        ...

    def sound(self, prior: Gaussian, shares: Array) -> np.ndarray:
        """Which of shares (J, m) can be used: (J,) bool; False where one is NaN."""
        ...

    def fuse(
        self, cycle: int, prior: Gaussian, known: Array, belief: Gaussian, shares: Array
    ) -> tuple[Array, Gaussian]:
        """What is known (m,) and believed after a round.

        Shares (1 + J, m) are the node's own and those of its neighbours, NaN where nothing came. A
        belief that is not finite, or not positive definite, says that it went wrong.
        """
        ...


class Content(NamedTuple):
    """A node's knowledge; `published` is the belief when it last sent, carried on to now."""

    prior: Gaussian
    belief: Gaussian
    known: Array
    ages: Array
    published: Gaussian | None
    cycles_in_step: int


@dataclass(frozen=True)
class FreshConsensus:
    """The estimator of such rules at a node with as many neighbours."""

    model: Model
    sensor: Sensor | None
    prior: Gaussian
    points: SigmaPointRule
    rule: FreshRule
    neighbours: int
    codec: VectorCodec
    trigger: float = 0.0

    @property
    def share_bytes(self) -> int:
        """Length of an encoded share."""
        return self.codec.size

    def start(self) -> Content:
        """The prior, and neighbours never heard."""
        known = self.rule.begin(self.prior, self.prior)
        return Content(self.prior, self.prior, known, np.full(self.neighbours, -1), None, 0)

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Predict, then take the own readings one by one."""
        troubles: list[str] = []
        prior, published = content.belief, content.published
        if measured.step > 0:
            beliefs = stacked([prior] if published is None else [prior, published])
            carried = carry(beliefs, control_of(measured), measured.step, self.model, self.points)
            if carried.sound[0]:
                prior = at(carried.beliefs, 0)
            else:
                troubles.append("predict-failed")
            if published is not None:
                published = at(carried.beliefs, 1) if carried.sound[1] else None
        belief, troubled = take_own(prior, measured, self.sensor, self.points)
        known = self.rule.begin(prior, belief)
        content = Content(prior, belief, known, content.ages, published, 0)
        return content, (*troubles, *troubled)

    def bid(self, content: Content) -> int | None:
        """How far the belief has moved since it was last published (`bids.bid_for_change`)."""
        if content.published is None:
            return FIRST_BID
        return asked(bid_for_change(content.belief, content.published, self.trigger))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """What the rule says in this round; the node remembers what it believed then."""
        body = self.codec.encode(self._say(content))
        return content._replace(published=content.belief), body

    def accept(self, body: bytes) -> Array:
        """The numbers in a share (`VectorCodec.decode`)."""
        return self.codec.decode(body)

    def fuse(
        self, content: Content, shares: tuple[Array | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """One round of the rule with what was heard, in sender order."""
        everyone, troubles = self._usable(content, shares)
        silent = np.isnan(everyone[1:]).any(axis=-1)
        ages = np.where(silent, np.where(content.ages < 0, -1, content.ages + 1), 0)
        cycle = content.cycles_in_step
        known, belief = self.rule.fuse(
            cycle, content.prior, content.known, content.belief, everyone
        )
        content = content._replace(ages=ages, cycles_in_step=cycle + 1)
        belief = Gaussian(belief.mean, symmetrise(belief.cov))
        if not believable(belief):
            return content, (*troubles, "fuse-failed")
        return content._replace(known=known, belief=belief), troubles

    def _usable(
        self, content: Content, shares: tuple[Array | None, ...]
    ) -> tuple[Array, tuple[str, ...]]:
        """The own share and the others' (1 + J, m), NaN where none came that can be used."""
        everyone = np.full((1 + len(shares), self.codec.length), np.nan)
        everyone[0] = self._say(content)
        came = [1 + j for j, share in enumerate(shares) if share is not None]
        if not came:
            return everyone, ()
        numbers = np.stack([share for share in shares if share is not None])
        sound = self.rule.sound(content.prior, numbers)
        everyone[came] = np.where(sound[:, None], numbers, np.nan)
        return everyone, ("rejected unsound",) * int((~sound).sum())

    def _say(self, content: Content) -> Array:
        return self.rule.say(content.cycles_in_step, content.known, content.belief)

    def belief(self, content: Content) -> Gaussian:
        """What the rule makes of all it has heard so far in this step."""
        return content.belief

    def ages(self, content: Content) -> Array:
        """Cycles since a share of each neighbour was last used."""
        return content.ages


def believable(belief: Gaussian) -> np.ndarray:
    """Whether beliefs (..., n) that a rule came to are finite and positive definite: (...) bool."""
    # Numbers near the largest that there are can leave a covariance of zero.
    definite = np.logical_not(np.isnan(cholesky(belief.cov)[..., 0, 0]))
    return np.logical_and(finite_lanes(belief), definite)
