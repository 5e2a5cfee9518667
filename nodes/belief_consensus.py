"""Consensus on beliefs: predict, take the own readings, then average with what neighbours share.

A neighbour that was silent in a round is represented by its last share. Shares grow old: the hold
policy says whether a held share is carried through the plant and what it still weighs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from filters.fusion import Averaged
from filters.gaussian import Gaussian
from filters.linalg import symmetrise
from filters.sigma_points import SigmaPointRule
from nodes.belief_codec import BeliefCodec
from nodes.bids import FIRST_BID, asked, bid_for_change
from nodes.local_filter import Model, Sensor, carry, control_of, finite, stacked, take_own
from nodes.messages import Array, Measured


class HoldPolicy(NamedTuple):
    """What becomes of the last share of a silent neighbour.

    `weigh(base_weights (..., J), ages (..., J), sharpness (..., J), cycles_in_step)` gives weights
    (..., J) that sum to one; entry 0 is the node itself; `cycles_in_step` is 0 in the first round
    of a step. `carried` says that held shares are predicted once per step like the own belief.
    `by_sharpness`: beliefs weigh by `hold.sharpness` beside their age; else it is 1 for all.
    """

    weigh: Callable[[Array, np.ndarray, Array, int], Array]
    carried: bool
    by_sharpness: bool = False


class Content(NamedTuple):
    """A node's knowledge: its own pair, the held pairs of its neighbours, what it last sent."""

    belief: Gaussian
    held: Gaussian
    ages: Array
    published: Gaussian | None
    cycles_in_step: int


@dataclass(frozen=True)
class BeliefConsensus:
    """The estimator of rules that average beliefs (covariance intersection, the paper's WAC)."""

    model: Model
    sensor: Sensor | None
    prior: Gaussian
    points: SigmaPointRule
    rule: Averaged
    hold: HoldPolicy
    weights: Array
    codec: BeliefCodec
    trigger: float = 0.0

    @property
    def share_bytes(self) -> int:
        """Length of an encoded belief."""
        return self.codec.size

    def start(self) -> Content:
        """The prior, and neighbours never heard (their place holds the prior at no weight)."""
        neighbours = len(self.weights) - 1
        held = Gaussian(
            np.repeat(self.prior.mean[None], neighbours, axis=0),
            np.repeat(self.prior.cov[None], neighbours, axis=0),
        )
        return Content(self.prior, held, np.full(neighbours, -1), None, 0)

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Predict everything that is carried, then take the own readings one by one."""
        troubles: list[str] = []
        if measured.step > 0:
            content, troubles = self._carry(content, measured)
        belief, troubled = take_own(content.belief, measured, self.sensor, self.points)
        content = content._replace(belief=belief, cycles_in_step=0)
        return content, (*troubles, *troubled)

    def _carry(self, content: Content, measured: Measured) -> tuple[Content, list[str]]:
        beliefs = [content.belief]
        if self.hold.carried:
            beliefs += [Gaussian(*pair) for pair in zip(*content.held, strict=True)]
        if self.hold.carried and content.published is not None:
            beliefs.append(content.published)
        carried = carry(
            stacked(beliefs), control_of(measured), measured.step, self.model, self.points
        )
        moved, sound = carried
        troubles = [] if sound[0] else ["predict-failed"]
        if sound[0]:
            content = content._replace(belief=carried.at(0))
        if not self.hold.carried:
            return content, troubles
        last = 1 + len(content.ages)
        # A held pair that cannot be carried on is forgotten, not used at a wrong time.
        ages = np.where(sound[1:last], content.ages, -1)
        held = Gaussian(
            np.where(sound[1:last, None], moved.mean[1:last], self.prior.mean),
            np.where(sound[1:last, None, None], moved.cov[1:last], self.prior.cov),
        )
        content = content._replace(held=held, ages=ages)
        if content.published is not None:
            content = content._replace(published=carried.at(last) if sound[last] else None)
        return content, troubles

    def bid(self, content: Content) -> int | None:
        """How far the belief has moved since it was last published (`bids.bid_for_change`)."""
        if content.published is None:
            return FIRST_BID
        return asked(bid_for_change(content.belief, content.published, self.trigger))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """The pair before the iteration; the node remembers what its neighbours now hold of it."""
        return content._replace(published=content.belief), self.codec.encode(content.belief)

    def accept(self, body: bytes) -> Gaussian:
        """The belief in a share (`BeliefCodec.decode`)."""
        return self.codec.decode(body)

    def fuse(
        self, content: Content, shares: tuple[Gaussian | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """Average the own pair with the neighbours' pairs, fresh or held, in sender order."""
        held = [Gaussian(*pair) for pair in zip(*content.held, strict=True)]
        heard = [j for j, share in enumerate(shares) if share is not None]
        pairs = zip(shares, held, strict=True)
        everyone = stacked([content.belief, *(old if new is None else new for new, old in pairs)])
        own = content.belief.mean
        numbers, sharpness = self.rule.weigh_up(everyone, own)
        unsound = [j for j in heard if math.isnan(sharpness[1 + j])]
        if unsound:
            # Few shares fail this check, and what is held instead is weighed up in a second go.
            usable = [None if j in unsound else share for j, share in enumerate(shares)]
            content, troubles = self.fuse(content, tuple(usable))
            return content, ("rejected not-positive-definite",) * len(unsound) + troubles
        ages = np.where(content.ages < 0, -1, content.ages + 1)
        ages[heard] = 0
        cycles = content.cycles_in_step
        if not self.hold.by_sharpness:
            sharpness = np.ones(len(self.weights))
        weights = self.hold.weigh(self.weights, np.concatenate(([0], ages)), sharpness, cycles)
        fused = self.rule.average(numbers, weights, own)
        content = content._replace(
            held=Gaussian(everyone.mean[1:], everyone.cov[1:]),
            ages=ages,
            cycles_in_step=cycles + 1,
        )
        if not finite(fused):
            return content, ("fuse-failed",)
        return content._replace(belief=Gaussian(fused.mean, symmetrise(fused.cov))), ()

    def belief(self, content: Content) -> Gaussian:
        """The own pair."""
        return content.belief

    def ages(self, content: Content) -> Array:
        """Cycles since each neighbour's held pair was sent."""
        return content.ages
