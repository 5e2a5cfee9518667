"""The nodes of a measurement bus: sensors that share what they measure, a receiver that estimates.

A step is one slot, so one communication cycle. A sensor knows what it sent. No bus here tells it
whether the receiver heard it. Where frames are lost, the sensor bids its change since it last sent,
and the receiver holds the value that it last heard.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from concord.features.measurement_bus.measurement_bus import bid
from concord.features.measurement_bus.measurement_codec import MeasurementCodec
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, from_wire


class Receiver(Protocol):
    """A filter behind a measurement bus; leading axes of its states are lanes.

    `failure` is counted where an update leaves a belief that is not a number.
    """

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the lengths m_1..m_N of the sensors' measurements."""
        ...

    @property
    def failure(self) -> str:
        """Return the word that is counted where an update fails."""
        ...

    def start(self, lanes: tuple[int, ...] = ()) -> Any:
        """Return the state at step 0, one of each lane."""
        ...

    def predict(self, state: Any, control: np.ndarray | None, step: int) -> Any:
        """Return the state at `step`, of that at the step before under a control (..., p)."""
        ...

    def update(self, state: Any, received: Received, step: int) -> Any:
        """Return the state after the slot of a step."""
        ...

    def belief(self, state: Any) -> Gaussian:
        """Return the belief: mean (..., n), cov (..., n, n)."""
        ...

    def generators(self, state: Any) -> np.ndarray | None:
        """Return the generators (n, q) of a zonotope; None of another belief."""
        ...

    def gap(self, state: Any) -> np.ndarray:
        """Return the duality gap (...) of a set relative to its trace; NaN where there is none."""
        ...


class SensorContent(NamedTuple):
    """A sensor between two events: its reading (m_j,), what it takes the receiver to hold of it,
    and whether the reading is on its way."""

    step: int
    reading: np.ndarray
    held: np.ndarray
    sent: bool


@dataclass(frozen=True)
class SensorNode:
    """The estimator of a sensor, which estimates nothing: its belief over `states` states is NaN.

    `held` (m_j,) is what the receiver holds at first; `weight` gives the Q_j (m_j, m_j) of its bids
    in a slot. The first slot is in step `first_slot`.
    """

    states: int
    neighbours: int
    held: np.ndarray
    weight: Callable[[int], np.ndarray]
    silent: Callable[[np.ndarray], np.ndarray]
    codec: MeasurementCodec
    first_slot: int

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
        """The weighted change since the last transmission (`measurement_bus.bid`)."""
        urgency = int(bid(content.reading - content.held, self.weight(content.step)))
        return None if urgency < 0 else urgency

    def compose(self, content: SensorContent) -> tuple[SensorContent, bytes]:
        """The reading."""
        return content._replace(sent=True), self.codec.encode(content.reading)

    def next_bytes(self, content: SensorContent) -> int:
        """Length of the share that `compose` would return."""
        return self.share_bytes

    def accept(self, body: bytes) -> np.ndarray:
        """A measurement (`MeasurementCodec.decode`); sensors have no use for it."""
        return self.codec.decode(body)

    def fuse(
        self, content: SensorContent, shares: tuple[np.ndarray | None, ...]
    ) -> tuple[SensorContent, tuple[str, ...]]:
        """The slot is over: know what the receiver holds now, if it heard what was sent."""
        if content.step < self.first_slot:
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
    """The receiver between two events: its filter's state, ybar (m,), slots since each sensor."""

    step: int
    state: Any
    received: np.ndarray
    ages: np.ndarray


@dataclass(frozen=True)
class ReceiverNode:
    """The estimator that hears the sensors; `received` (m,) is what it holds at first.

    The first slot is in step `first_slot`. A receiver that begins at a later step than 0 has heard
    nothing of the steps before.
    """

    receiver: Receiver
    received: np.ndarray
    silent: Callable[[np.ndarray], np.ndarray]
    codec: MeasurementCodec
    first_slot: int
    first_step: int = 0

    @property
    def share_bytes(self) -> int:
        """Length of an encoded measurement."""
        return self.codec.size

    def start(self) -> ReceiverContent:
        """The prior, carried to the step before the first."""
        state = self.receiver.start()
        for step in range(1, self.first_step):
            state = self.receiver.predict(state, None, step)
        never = np.full(len(self.receiver.sizes), -1)
        return ReceiverContent(max(self.first_step - 1, 0), state, self.received, never)

    def begin_step(
        self, content: ReceiverContent, measured: Measured
    ) -> tuple[ReceiverContent, tuple[str, ...]]:
        """Predict."""
        content = content._replace(step=measured.step)
        if measured.step == 0:
            return content, ()
        control = None if measured.control is None else np.array(measured.control)
        moved = self.receiver.predict(content.state, control, measured.step)
        return content._replace(state=moved), self._trouble(content.state, moved, "predict-failed")

    def bid(self, content: ReceiverContent) -> int | None:
        """The receiver has nothing to send."""
        return None

    def compose(self, content: ReceiverContent) -> tuple[ReceiverContent, bytes]:
        """Nothing."""
        return content, self.codec.encode(np.empty(0))

    def next_bytes(self, content: ReceiverContent) -> int:
        """Length of the share that `compose` would return."""
        return self.share_bytes

    def accept(self, body: bytes) -> np.ndarray:
        """The measurement in a share (`MeasurementCodec.decode`)."""
        return self.codec.decode(body)

    def fuse(
        self, content: ReceiverContent, shares: tuple[np.ndarray | None, ...]
    ) -> tuple[ReceiverContent, tuple[str, ...]]:
        """Update with what came in this slot, one entry per sensor."""
        if content.step < self.first_slot:
            return content, ()
        came = [
            _whole(share, size) for share, size in zip(shares, self.receiver.sizes, strict=True)
        ]
        values = np.concatenate(came)
        fresh = ~np.isnan(values)
        received = np.where(fresh, values, self.silent(content.received))
        heard = ~np.isnan([measurement[0] for measurement in came])
        state = self.receiver.update(content.state, Received(received, fresh), content.step)
        ages = np.where(heard, 0, np.where(content.ages < 0, -1, content.ages + 1))
        failures = self._trouble(content.state, state, self.receiver.failure)
        return content._replace(state=state, received=received, ages=ages), failures

    def belief(self, content: ReceiverContent) -> Gaussian:
        """Return the belief of the filter."""
        return self.receiver.belief(content.state)

    def generators(self, content: ReceiverContent) -> np.ndarray | None:
        """Return the generators (n, q) of a zonotope; None of another belief."""
        return self.receiver.generators(content.state)

    def gap(self, content: ReceiverContent) -> float | None:
        """Return the duality gap of a set relative to its trace; None where there is none."""
        found = float(self.receiver.gap(content.state))
        return None if np.isnan(found) else found

    def ages(self, content: ReceiverContent) -> np.ndarray:
        """Slots since each sensor was heard; -1 never."""
        return content.ages

    def _trouble(self, before: Any, after: Any, name: str) -> tuple[str, ...]:
        """The name, where a belief has just stopped being a number."""
        covs = (self.receiver.belief(state).cov for state in (after, before))
        is_finite, was_finite = (bool(np.isfinite(cov).all()) for cov in covs)
        return (name,) if was_finite and not is_finite else ()


def _whole(share: np.ndarray | None, size: int) -> np.ndarray:
    """A sensor's measurement (size,) if it came complete, otherwise NaN."""
    if share is None or np.isnan(share[:size]).any():
        return np.full(size, np.nan)
    return share[:size]
