"""The nodes of a measurement bus: sensors that share what they measure, a receiver that estimates.

A step is one slot, so one communication cycle. At step 0 nothing has been measured and the belief
is the prior. The sensors know what the receiver holds of them, because they know what they sent.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.bus.measurement_bus import bid
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule
from concord.filters.stochastic_ukf import (
    Dynamics,
    MeasurementFilter,
    Observation,
    Received,
    SecondMoment,
)
from concord.nodes.messages import Measured, from_wire
from concord.nodes.rules.measurement_codec import MeasurementCodec


class System(Protocol):
    """Model of the plant for a filter behind a measurement bus (see
    `concord.plants.stochastic`)."""

    @property
    def sizes(self) -> tuple[int, ...]: ...

    @property
    def transition(self) -> Callable[[np.ndarray, np.ndarray | None, int], np.ndarray]: ...

    @property
    def measure(self) -> Callable[[np.ndarray, int], np.ndarray]: ...

    @property
    def process_noise_cov(self) -> Callable[[int], np.ndarray]: ...

    @property
    def measurement_noise_cov(self) -> Callable[[int], np.ndarray]: ...

    def process_moment(self, step: int) -> SecondMoment: ...

    def measurement_moment(self, step: int) -> SecondMoment: ...


def dynamics(system: System, control: np.ndarray | None, step: int) -> Dynamics:
    """Return the dynamics of the state from `step` to the next."""
    return Dynamics(
        lambda points: system.transition(points, control, step),
        system.process_noise_cov(step),
        system.process_moment(step),
    )


def observation(system: System, step: int) -> Observation:
    """Return the observation of the sensors at `step`."""
    return Observation(
        lambda points: system.measure(points, step),
        system.measurement_noise_cov(step),
        system.measurement_moment(step),
    )


class SensorContent(NamedTuple):
    """A sensor between two events: its reading (m_j,), what the receiver holds of it, and whether
    the reading is on its way."""

    step: int
    reading: np.ndarray
    held: np.ndarray
    sent: bool


@dataclass(frozen=True)
class SensorNode:
    """The estimator of a sensor, which estimates nothing: its belief over `states` states is NaN.

    `held` (m_j,) is what the receiver holds at first, `weight` (m_j, m_j) the Q_j of its bids.
    """

    states: int
    neighbours: int
    held: np.ndarray
    weight: np.ndarray
    silent: Callable[[np.ndarray], np.ndarray]
    codec: MeasurementCodec

    @property
    def share_bytes(self) -> int:
        """Length of an encoded measurement."""
        return self.codec.size

    def start(self) -> SensorContent:
        """Nothing read, nothing sent."""
        return SensorContent(0, np.full_like(self.held, np.nan), self.held, False)

    def begin_step(
        self, content: SensorContent, measured: Measured
    ) -> tuple[SensorContent, tuple[str, ...]]:
        """Take the reading."""
        reading = from_wire(measured.readings)[0, : len(self.held)]
        return SensorContent(measured.step, reading, content.held, False), ()

    def bid(self, content: SensorContent) -> int | None:
        """The weighted change since the last transmission (`concord.bus.measurement_bus.bid`)."""
        urgency = int(bid(content.reading - content.held, self.weight))
        return None if urgency < 0 else urgency

    def compose(self, content: SensorContent) -> tuple[SensorContent, bytes]:
        """The reading."""
        return content._replace(sent=True), self.codec.encode(content.reading)

    def accept(self, body: bytes) -> np.ndarray:
        """A measurement (`MeasurementCodec.decode`); sensors have no use for it."""
        return self.codec.decode(body)

    def fuse(
        self, content: SensorContent, shares: tuple[np.ndarray | None, ...]
    ) -> tuple[SensorContent, tuple[str, ...]]:
        """The slot is over: know what the receiver holds now."""
        if content.step == 0:
            return content, ()
        held = self.silent(content.held)
        if content.sent and not np.isnan(content.reading).any():
            # The value as decoded from the frame, which may carry fewer digits.
            held = self.codec.decode(self.codec.encode(content.reading))[: len(held)]
        return content._replace(held=held), ()

    def belief(self, content: SensorContent) -> Gaussian:
        """A sensor believes nothing."""
        return Gaussian(np.full(self.states, np.nan), np.full((self.states, self.states), np.nan))

    def ages(self, content: SensorContent) -> np.ndarray:
        """Return -1 for each neighbour: a sensor hears no node."""
        return np.full(self.neighbours, -1)


class ReceiverContent(NamedTuple):
    """The receiver between two events: the filter's state, ybar (m,), slots since each sensor."""

    step: int
    state: Any
    received: np.ndarray
    ages: np.ndarray


@dataclass(frozen=True)
class ReceiverNode:
    """The estimator that hears the sensors; `received` (m,) is what it holds at first."""

    system: System
    filter: MeasurementFilter
    prior: Gaussian
    points: SigmaPointRule
    received: np.ndarray
    silent: Callable[[np.ndarray], np.ndarray]
    codec: MeasurementCodec

    @property
    def share_bytes(self) -> int:
        """Length of an encoded measurement."""
        return self.codec.size

    def start(self) -> ReceiverContent:
        """The prior at step 0."""
        state = self.filter.start(self.prior, observation(self.system, 0), self.points)
        return ReceiverContent(0, state, self.received, np.full(len(self.system.sizes), -1))

    def begin_step(
        self, content: ReceiverContent, measured: Measured
    ) -> tuple[ReceiverContent, tuple[str, ...]]:
        """Predict."""
        content = content._replace(step=measured.step)
        if measured.step == 0:
            return content, ()
        control = None if measured.control is None else np.array(measured.control)
        moved = self.filter.predict(
            content.state, dynamics(self.system, control, measured.step - 1), self.points
        )
        return content._replace(state=moved), _trouble(content.state, moved, "predict-failed")

    def bid(self, content: ReceiverContent) -> int | None:
        """The receiver has nothing to send."""
        return None

    def compose(self, content: ReceiverContent) -> tuple[ReceiverContent, bytes]:
        """Nothing."""
        return content, self.codec.encode(np.empty(0))

    def accept(self, body: bytes) -> np.ndarray:
        """The measurement in a share (`MeasurementCodec.decode`)."""
        return self.codec.decode(body)

    def fuse(
        self, content: ReceiverContent, shares: tuple[np.ndarray | None, ...]
    ) -> tuple[ReceiverContent, tuple[str, ...]]:
        """Update with what came in this slot, one entry per sensor."""
        if content.step == 0:
            return content, ()
        came = [_whole(share, size) for share, size in zip(shares, self.system.sizes, strict=True)]
        values = np.concatenate(came)
        fresh = ~np.isnan(values)
        received = np.where(fresh, values, self.silent(content.received))
        heard = ~np.isnan([measurement[0] for measurement in came])
        state = self.filter.update(
            content.state,
            Received(received, fresh),
            observation(self.system, content.step),
            self.points,
        )
        ages = np.where(heard, 0, np.where(content.ages < 0, -1, content.ages + 1))
        failures = _trouble(content.state, state, "update-failed")
        return content._replace(state=state, received=received, ages=ages), failures

    def belief(self, content: ReceiverContent) -> Gaussian:
        """Return the belief of the filter."""
        return content.state.belief

    def ages(self, content: ReceiverContent) -> np.ndarray:
        """Slots since each sensor was heard; -1 never."""
        return content.ages


def _whole(share: np.ndarray | None, size: int) -> np.ndarray:
    """A sensor's measurement (size,) if it came complete, otherwise NaN."""
    if share is None or np.isnan(share[:size]).any():
        return np.full(size, np.nan)
    return share[:size]


def _trouble(before: Any, after: Any, name: str) -> tuple[str, ...]:
    """The name, where a belief has just stopped being a number."""
    failed = not np.isfinite(after.belief.cov).all() and np.isfinite(before.belief.cov).all()
    return (name,) if failed else ()
