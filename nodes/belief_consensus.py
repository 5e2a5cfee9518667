"""Consensus on beliefs: predict, take the own readings, then average with what neighbours share.

A neighbour that was silent in a round is represented by its last share. Shares grow old: the hold
policy says whether a held share is carried through the plant and what it still weighs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from filters.gaussian import Gaussian
from filters.linalg import cholesky, symmetrise
from filters.sigma_points import SigmaPointRule
from filters.ukf import predict, update
from nodes.belief_codec import BeliefCodec
from nodes.messages import Array, Measured, from_wire

FIRST_BID = 2**31 - 1
BID_RESOLUTION = 1 / 1024


class Model(Protocol):
    """What a filter believes of the plant."""

    def transition(self, state: Array, control: Array | None, step: int) -> Array:
        """State (..., n) at `step + 1` from the state at `step`."""
        ...

    def process_noise_cov(self, step: int) -> Array:
        """Covariance (n, n) of what the transition from `step` does not know."""
        ...


class Sensor(Protocol):
    """What a node believes of its own readings."""

    @property
    def gate(self) -> float | None:
        """Chi-square threshold beyond which a reading is refused; None takes every reading."""
        ...

    def measure(self, state: Array, step: int) -> Array:
        """The reading (..., m) that a state (..., n) gives."""
        ...

    def residual(self, value: Array, predicted: Array, /) -> Array:
        """The difference of two readings (..., m), angles wrapped."""
        ...

    def interpret(self, delivered: Array) -> tuple[Array, Array]:
        """Value (m,) and noise covariance (m, m) of a delivered reading (d,)."""
        ...


class HoldPolicy(NamedTuple):
    """What becomes of the last share of a silent neighbour.

    `weigh(base_weights (J,), ages (J,), covs (J, n, n), cycles_in_step)` gives weights (J,) that
    sum to one; entry 0 is the node itself; `cycles_in_step` is 0 in the first round of a step.
    `carried` says that held shares are predicted once per step like the own belief.
    """

    weigh: Callable[[Array, Array, Array, int], Array]
    carried: bool


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
            control = None if measured.control is None else np.array(measured.control)
            content, troubles = self._carry(content, control, measured.step - 1)
        belief = content.belief
        for delivered in from_wire(measured.readings):
            belief, trouble = self._take(belief, delivered, measured.step)
            troubles += trouble
        return content._replace(belief=belief, cycles_in_step=0), tuple(troubles)

    def _carry(
        self, content: Content, control: Array | None, step: int
    ) -> tuple[Content, list[str]]:
        carried = [content.belief]
        if self.hold.carried:
            carried += [Gaussian(*pair) for pair in zip(*content.held, strict=True)]
        if self.hold.carried and content.published is not None:
            carried.append(content.published)
        # One call for all of them: the plant's functions cost more to enter than to evaluate.
        moved = predict(
            Gaussian(np.stack([b.mean for b in carried]), np.stack([b.cov for b in carried])),
            partial(self.model.transition, control=control, step=step),
            self.model.process_noise_cov(step),
            self.points,
        )
        sound = _finite_lanes(moved)
        troubles = [] if sound[0] else ["predict-failed"]
        if sound[0]:
            content = content._replace(belief=Gaussian(moved.mean[0], moved.cov[0]))
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
            published = Gaussian(moved.mean[last], moved.cov[last]) if sound[last] else None
            content = content._replace(published=published)
        return content, troubles

    def _take(self, belief: Gaussian, delivered: Array, step: int) -> tuple[Gaussian, list[str]]:
        if self.sensor is None or np.isnan(delivered).all():
            return belief, []
        value, noise_cov = self.sensor.interpret(delivered)
        result = update(
            belief,
            value,
            partial(self.sensor.measure, step=step),
            noise_cov,
            self.points,
            residual=self.sensor.residual,
            gate=self.sensor.gate,
        )
        if not _finite(result.belief):
            return belief, ["update-failed"]
        gate = self.sensor.gate
        gated = gate is not None and result.normalised_innovation_squared > gate
        return result.belief, ["gated"] if gated else []

    def bid(self, content: Content) -> int | None:
        """Squared change since the last publication in units of the own covariance, quantised.

        An integer, so that arbitration does not hang on the last bit; who has never published asks
        most urgently. None where the change does not exceed the trigger.
        """
        if content.published is None:
            return FIRST_BID
        change = content.belief.mean - content.published.mean
        squared = change @ np.linalg.solve(content.belief.cov, change)
        if squared < self.trigger:
            return None
        return int(min(max(squared, 0.0) / BID_RESOLUTION, FIRST_BID - 1))

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
        weights = self.hold.weigh(self.weights, np.concatenate(([0], ages)), everyone.cov, cycles)
        fused = self.average(everyone, weights)
        content = content._replace(held=Gaussian(means, covs), ages=ages, cycles_in_step=cycles + 1)
        if not _finite(fused):
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


def _finite_lanes(beliefs: Gaussian) -> np.ndarray:
    finite_mean = np.isfinite(beliefs.mean).all(axis=-1)
    return np.logical_and(finite_mean, np.isfinite(beliefs.cov).all(axis=(-1, -2)))


def _finite(belief: Gaussian) -> bool:
    return bool(_finite_lanes(belief))
