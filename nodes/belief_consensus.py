"""Consensus on beliefs: predict, take the own readings, then average with what neighbours share.

A neighbour that was silent in a round is represented by its last share. Shares grow old: the hold
policy says whether a held share is carried through the plant and what it still weighs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, symmetrise
from filters.sigma_points import SigmaPointRule
from nodes.belief_codec import BeliefCodec
from nodes.bids import FIRST_BID, asked, bid_for_change
from nodes.local_filter import Model, Sensor, carry, control_of, finite, stacked, take_own
from nodes.messages import Array, Measured


def alike(covs: Array) -> Array:
    """Sharpness 1 (...) of all covariances (..., n, n)."""
    return np.ones(covs.shape[:-2])


class HoldPolicy(NamedTuple):
    """What becomes of the last share of a silent neighbour.

    `weigh(base_weights (..., J), ages (..., J), sharpness (..., J), cycles_in_step)` gives weights
    (..., J) that sum to one; entry 0 is the node itself; `cycles_in_step` is 0 in the first round
    of a step. `carried` says that held shares are predicted once per step like the own belief.
    `sharpness` of covariances (..., n, n) is what beliefs weigh beside their age.
    """

    weigh: Callable[[Array, np.ndarray, Array, int], Array]
    carried: bool
    sharpness: Callable[[Array], Array] = alike


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
    average: Callable[[Gaussian, Array], Gaussian]
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
        ages = np.where(content.ages < 0, -1, content.ages + 1)
        means, covs = content.held.mean.copy(), content.held.cov.copy()
        heard, troubles = _usable(shares)
        for j, share in heard:
            means[j], covs[j], ages[j] = share.mean, share.cov, 0
        everyone = Gaussian(
            np.concatenate((content.belief.mean[None], means)),
            np.concatenate((content.belief.cov[None], covs)),
        )
        cycles = content.cycles_in_step
        sharpness = self.hold.sharpness(everyone.cov)
        weights = self.hold.weigh(self.weights, np.concatenate(([0], ages)), sharpness, cycles)
        fused = self.average(everyone, weights)
        content = content._replace(held=Gaussian(means, covs), ages=ages, cycles_in_step=cycles + 1)
        if not finite(fused):
            return content, (*troubles, "fuse-failed")
        return content._replace(belief=Gaussian(fused.mean, symmetrise(fused.cov))), troubles

    def belief(self, content: Content) -> Gaussian:
        """The own pair."""
        return content.belief

    def ages(self, content: Content) -> Array:
        """Cycles since each neighbour's held pair was sent."""
        return content.ages


def _usable(
    shares: tuple[Gaussian | None, ...],
) -> tuple[list[tuple[int, Gaussian]], tuple[str, ...]]:
    """The shares that came, with their places; what is no covariance is dropped and named."""
    came = [(j, share) for j, share in enumerate(shares) if share is not None]
    if not came:
        return [], ()
    # All in one call: a check for each share as it comes would cost more than the fusion.
    factors = cholesky(np.stack([share.cov for _, share in came]))
    sound = np.isfinite(factors[:, -1, -1])
    usable = [one for one, good in zip(came, sound, strict=True) if good]
    return usable, ("rejected not-positive-definite",) * (len(came) - len(usable))
