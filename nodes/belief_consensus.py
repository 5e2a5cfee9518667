"""Consensus on beliefs: predict, take the own readings, then average with what neighbours share.

A neighbour that was silent in a round is represented by its last share. Shares grow old: the hold
policy says whether a held share is carried through the plant and what it still weighs.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from filters.fusion import Averaged
from filters.gaussian import Gaussian
from filters.hold import sharpened, sharpness_of_factor
from filters.linalg import symmetrise
from filters.sigma_points import SigmaPointRule
from nodes.belief_codec import BeliefCodec
from nodes.bids import FIRST_BID, asked, bid_for_change
from nodes.local_filter import (
    Model,
    Sensor,
    carry,
    control_of,
    finite,
    listed,
    stacked,
    take_own,
    where,
)
from nodes.messages import Array, Measured


class HoldPolicy(NamedTuple):
    """What becomes of the last share of a silent neighbour.

    `weigh(base_weights (..., J), ages (..., J), sharpness (..., J), cycles_in_step)` gives weights
    (..., J) that sum to one; entry 0 is the node itself; `cycles_in_step` is 0 in the first round
    of a step. `carried` says that held shares are predicted once per step like the own belief.
    `by_sharpness`: beliefs weigh by `hold.sharpness` beside their age, each weight multiplied by it
    (`hold.sharpened`); else it is 1 for all.
    """

    weigh: Callable[[Array, np.ndarray, Array, int], Array]
    carried: bool
    by_sharpness: bool = False


class Content(msgspec.Struct, frozen=True):
    """A node's knowledge: its own pair, the held pairs of its neighbours, what it last sent."""

    belief: Gaussian
    held: Gaussian
    ages: tuple[int, ...]
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
        return Content(self.prior, held, (-1,) * neighbours, None, 0)

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Predict everything that is carried, then take the own readings one by one."""
        troubles: tuple[str, ...] = ()
        if measured.step > 0:
            content, troubles = self._carry(content, measured)
        belief, troubled = take_own(content.belief, measured, self.sensor, self.points)
        return replace(content, belief=belief, cycles_in_step=0), troubles + troubled

    def _carry(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        beliefs, published = [content.belief], content.published
        if self.hold.carried:
            beliefs += listed(content.held)
            beliefs += [] if published is None else [published]
        control = control_of(measured)
        carried = carry(stacked(beliefs), control, measured.step, self.model, self.points)
        moved, sound = carried
        troubles = () if sound[0] else ("predict-failed",)
        if sound[0]:
            content = replace(content, belief=carried.at(0))
        if not self.hold.carried:
            return content, troubles
        last = 1 + len(content.ages)
        if published is not None:
            published = carried.at(last) if sound[last] else None
        held, ages = Gaussian(moved.mean[1:last], moved.cov[1:last]), content.ages
        if not sound.all():
            # A held pair that cannot be carried on is forgotten, not used at a wrong time.
            held = where(sound[1:last], held, self.prior)
            ages = tuple(age if sound[1 + j] else -1 for j, age in enumerate(ages))
        return replace(content, held=held, ages=ages, published=published), troubles

    def bid(self, content: Content) -> int | None:
        """How far the belief has moved since it was last published (`bids.bid_for_change`)."""
        if content.published is None:
            return FIRST_BID
        return asked(bid_for_change(content.belief, content.published, self.trigger))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """The pair before the iteration; the node remembers what its neighbours now hold of it."""
        return replace(content, published=content.belief), self.codec.encode(content.belief)

    def accept(self, body: bytes) -> Gaussian:
        """The belief in a share (`BeliefCodec.decode`)."""
        return self.codec.decode(body)

    def fuse(
        self, content: Content, shares: tuple[Gaussian | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """Average the own pair with the neighbours' pairs, fresh or held, in sender order."""
        fresh = [share is not None for share in shares]
        everyone = stacked([content.belief, *_with_held(shares, content.held)])
        own = content.belief.mean
        numbers, factors = self.rule.weigh_up(everyone, own)
        pivots = factors[1:, -1, -1].tolist()
        unsound = [j for j, pivot in enumerate(pivots) if fresh[j] and math.isnan(pivot)]
        if unsound:
            # Few shares fail this check, and what is held instead is weighed up in a second go.
            usable = [None if j in unsound else share for j, share in enumerate(shares)]
            content, troubles = self.fuse(content, tuple(usable))
            return content, ("rejected not-positive-definite",) * len(unsound) + troubles
        ages = tuple(
            0 if new else age if age < 0 else age + 1
            for new, age in zip(fresh, content.ages, strict=True)
        )
        fused = self.rule.average(numbers, self._weights(factors, ages, content), own)
        sound = finite(fused)
        after = Content(
            belief=Gaussian(fused.mean, symmetrise(fused.cov)) if sound else content.belief,
            held=Gaussian(everyone.mean[1:], everyone.cov[1:]),
            ages=ages,
            published=content.published,
            cycles_in_step=content.cycles_in_step + 1,
        )
        return after, () if sound else ("fuse-failed",)

    def _weights(self, factors: Array, ages: tuple[int, ...], content: Content) -> Array:
        """What the own pair and each neighbour's weigh in this round: (1 + J,)."""
        weights = self._weights_of_ages(ages, content.cycles_in_step)
        return (
            sharpened(weights, sharpness_of_factor(factors)) if self.hold.by_sharpness else weights
        )

    @cached_property
    def _weights_of_ages(self) -> Callable[[tuple[int, ...], int], Array]:
        # Kept: few patterns of ages come again and again.
        @lru_cache
        def weigh(ages: tuple[int, ...], cycles: int) -> Array:
            alike = np.ones(len(self.weights))
            return self.hold.weigh(self.weights, np.array((0, *ages)), alike, cycles)

        return weigh

    def belief(self, content: Content) -> Gaussian:
        """The own pair."""
        return content.belief

    def ages(self, content: Content) -> Array:
        """Cycles since each neighbour's held pair was sent."""
        return np.array(content.ages, dtype=int)


def _with_held(shares: tuple[Gaussian | None, ...], held: Gaussian) -> list[Gaussian]:
    """The shares, and in the place of every one that is missing the held pair."""
    came = [share for share in shares if share is not None]
    if len(came) == len(shares):
        return came
    pairs = zip(shares, listed(held), strict=True)
    return [old if new is None else new for new, old in pairs]
