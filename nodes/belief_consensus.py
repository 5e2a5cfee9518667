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
    at,
    carry,
    control_of,
    finite,
    take_own,
    where,
    with_own,
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
    """A node's knowledge: beliefs (1 + J + 1, n), its own first, then what it holds of its
    neighbours, last what it has sent and they hold of it, if it has (`is_published`).

    All lie together, as all are carried through the plant at once.
    """

    beliefs: Gaussian
    ages: tuple[int, ...]
    is_published: bool
    cycles_in_step: int

    @property
    def belief(self) -> Gaussian:
        """The node's own."""
        return at(self.beliefs, 0)

    @property
    def published(self) -> Gaussian | None:
        """What its neighbours hold of it."""
        return at(self.beliefs, -1) if self.is_published else None


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
        beliefs = Gaussian(
            np.repeat(self.prior.mean[None], 1 + neighbours + 1, axis=0),
            np.repeat(self.prior.cov[None], 1 + neighbours + 1, axis=0),
        )
        return Content(beliefs, (-1,) * neighbours, False, 0)

    def begin_step(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        """Predict everything that is carried, then take the own readings one by one."""
        troubles: tuple[str, ...] = ()
        if measured.step > 0:
            content, troubles = self._carry(content, measured)
        before = content.belief
        belief, troubled = take_own(before, measured, self.sensor, self.points)
        beliefs = content.beliefs if belief is before else with_own(content.beliefs, belief)
        return replace(content, beliefs=beliefs, cycles_in_step=0), troubles + troubled

    def _carry(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        before = content.beliefs
        carries = before if self.hold.carried else Gaussian(before.mean[:1], before.cov[:1])
        control = control_of(measured)
        moved, sound = carry(carries, control, measured.step, self.model, self.points)
        troubles = () if sound[0] else ("predict-failed",)
        if not self.hold.carried:
            moved = with_own(before, at(moved, 0)) if sound[0] else before
            return replace(content, beliefs=moved), troubles
        ages, is_published = content.ages, content.is_published
        if not sound.all():
            # A held pair that cannot be carried on is forgotten, not used at a wrong time.
            moved = where(sound, moved, self.prior)
            if not sound[0]:
                moved = with_own(moved, content.belief)
            ages = tuple(age if sound[1 + j] else -1 for j, age in enumerate(ages))
            is_published = bool(is_published and sound[-1])
        return replace(content, beliefs=moved, ages=ages, is_published=is_published), troubles

    def bid(self, content: Content) -> int | None:
        """How far the belief has moved since it was last published (`bids.bid_for_change`)."""
        published = content.published
        if published is None:
            return FIRST_BID
        return asked(bid_for_change(content.belief, published, self.trigger))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """The pair before the iteration; the node remembers what its neighbours now hold of it."""
        mean, cov = content.beliefs.mean.copy(), content.beliefs.cov.copy()
        mean[-1], cov[-1] = mean[0], cov[0]
        content = replace(content, beliefs=Gaussian(mean, cov), is_published=True)
        return content, self.codec.encode(content.belief)

    def accept(self, body: bytes) -> Array:
        """The numbers of the belief in a share (`BeliefCodec.read`)."""
        return self.codec.read(body)

    def fuse(
        self, content: Content, shares: tuple[Array | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """Average the own pair with the neighbours' pairs, fresh or held, in sender order."""
        mean, cov = self._with_shares(content.beliefs, shares)
        own = content.beliefs.mean[0]
        numbers, factors = self.rule.weigh_up(Gaussian(mean[:-1], cov[:-1]), own)
        pivots = factors[1:, -1, -1].tolist()
        unsound = [
            j for j, pivot in enumerate(pivots) if math.isnan(pivot) and shares[j] is not None
        ]
        if unsound:
            # Few shares fail this check, and what is held instead is weighed up in a second go.
            usable = [None if j in unsound else share for j, share in enumerate(shares)]
            content, troubles = self.fuse(content, tuple(usable))
            return content, ("rejected not-positive-definite",) * len(unsound) + troubles
        ages = tuple(
            0 if share is not None else age if age < 0 else age + 1
            for share, age in zip(shares, content.ages, strict=True)
        )
        fused = self.rule.average(numbers, self._weights(factors, ages, content), own)
        sound = finite(fused)
        if sound:
            mean[0], cov[0] = fused.mean, symmetrise(fused.cov)
        after = Content(Gaussian(mean, cov), ages, content.is_published, content.cycles_in_step + 1)
        return after, () if sound else ("fuse-failed",)

    def _with_shares(self, beliefs: Gaussian, shares: tuple[Array | None, ...]) -> Gaussian:
        """A copy of the beliefs with each share in the place of its sender."""
        mean, cov = beliefs.mean.copy(), beliefs.cov.copy()
        came = [1 + j for j, share in enumerate(shares) if share is not None]
        if came:
            told = self.codec.unpack(np.array([share for share in shares if share is not None]))
            # Mostly all have come: a slice costs a fraction of what a list of places does.
            places = slice(1, -1) if len(came) == len(shares) else came
            mean[places], cov[places] = told
        return Gaussian(mean, cov)

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
