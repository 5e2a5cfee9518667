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
from filters.gaussian import Gaussian, joined
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
    """A node's knowledge: its `own` belief (n,), what it holds of its J neighbours (J, n), and what
    it has sent and they hold of it (n,), if it has."""

    own: Gaussian
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
        own, troubled = take_own(content.own, measured, self.sensor, self.points)
        return replace(content, own=own, cycles_in_step=0), troubles + troubled

    def _carry(self, content: Content, measured: Measured) -> tuple[Content, tuple[str, ...]]:
        before = content.own
        if self.hold.carried:
            carries = joined(before, content.held, content.published or before)
        else:
            carries = stacked([before])
        control = control_of(measured)
        moved, sound = carry(carries, control, measured.step, self.model, self.points)
        own, troubles = (at(moved, 0), ()) if sound[0] else (before, ("predict-failed",))
        if not self.hold.carried:
            return replace(content, own=own), troubles
        ages, published = content.ages, content.published and at(moved, -1)
        if not sound.all():
            # A held pair that cannot be carried on is forgotten, not used at a wrong time.
            moved = where(sound, moved, self.prior)
            ages = tuple(age if sound[1 + j] else -1 for j, age in enumerate(ages))
            published = published if sound[-1] else None
        held = Gaussian(moved.mean[1:-1], moved.cov[1:-1])
        return replace(content, own=own, held=held, ages=ages, published=published), troubles

    def bid(self, content: Content) -> int | None:
        """How far the belief has moved since it was last published (`bids.bid_for_change`)."""
        published = content.published
        if published is None:
            return FIRST_BID
        return asked(bid_for_change(content.own, published, self.trigger))

    def compose(self, content: Content) -> tuple[Content, bytes]:
        """The pair before the iteration; the node remembers what its neighbours now hold of it."""
        return replace(content, published=content.own), self.codec.encode(content.own)

    def accept(self, body: bytes) -> bytes:
        """A body of which a belief can be read (`BeliefCodec.check`)."""
        return self.codec.check(body)

    def fuse(
        self, content: Content, shares: tuple[bytes | None, ...]
    ) -> tuple[Content, tuple[str, ...]]:
        """Average the own pair with the neighbours' pairs, fresh or held, in sender order."""
        own, held = content.own, self._with_shares(content.held, shares)
        ages = _aged(content.ages, shares)
        weights = self._weights_of_ages(ages, content.cycles_in_step)
        fused = self.rule.fuse(own, held, weights, self.hold.by_sharpness)
        unsound = _unsound(fused.sharpness[1:].tolist(), shares)
        if unsound:
            # Few shares fail this check, and what is held instead is weighed up in a second go.
            usable = [None if j in unsound else share for j, share in enumerate(shares)]
            content, troubles = self.fuse(content, tuple(usable))
            return content, ("rejected not-positive-definite",) * len(unsound) + troubles
        troubles = ()
        if finite(fused.belief):
            own = fused.belief
        else:
            troubles = ("fuse-failed",)
        return Content(own, held, ages, content.published, content.cycles_in_step + 1), troubles

    def _with_shares(self, held: Gaussian, shares: tuple[bytes | None, ...]) -> Gaussian:
        """The held beliefs, with each share in the place of its sender."""
        came = [share for share in shares if share is not None]
        if not came:
            return held
        told = self.codec.unpack(*came)
        if len(came) == len(shares):
            return told
        mean, cov = held.mean.copy(), held.cov.copy()
        places = [j for j, share in enumerate(shares) if share is not None]
        mean[places], cov[places] = told
        return Gaussian(mean, cov)

    @cached_property
    def _weights_of_ages(self) -> Callable[[tuple[int, ...], int], Array]:
        """What the own pair and each neighbour's weigh in a round but for their sharpness."""

        # Kept: few patterns of ages come again and again.
        @lru_cache
        def weigh(ages: tuple[int, ...], cycles: int) -> Array:
            alike = np.ones(len(self.weights))
            return self.hold.weigh(self.weights, np.array((0, *ages)), alike, cycles)

        return weigh

    def belief(self, content: Content) -> Gaussian:
        """The own pair."""
        return content.own

    def ages(self, content: Content) -> Array:
        """Cycles since each neighbour's held pair was sent."""
        return np.array(content.ages, dtype=int)


def _unsound(sharpness: list[float], shares: tuple[bytes | None, ...]) -> list[int]:
    """The places of shares of this sharpness that are not positive definite: theirs is NaN."""
    if not math.isnan(sum(sharpness)):
        return []
    return [j for j, sharp in enumerate(sharpness) if math.isnan(sharp) and shares[j] is not None]


def _aged(ages: tuple[int, ...], shares: tuple[bytes | None, ...]) -> tuple[int, ...]:
    """How old what is held is, one cycle later, when these shares have come."""
    if None not in shares:
        return (0,) * len(shares)
    return tuple(
        0 if share is not None else age if age < 0 else age + 1
        for share, age in zip(shares, ages, strict=True)
    )
