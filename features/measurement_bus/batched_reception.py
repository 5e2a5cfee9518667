"""The sensors and the receiver of a measurement bus in many runs at once."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from concord.bus.arbitration import NO_BID
from concord.features.measurement_bus.measurement_bus import RECEIVER, MeasurementBus
from concord.features.measurement_bus.measurement_codec import MeasurementCodec
from concord.features.measurement_bus.reception import Receiver
from concord.features.measurement_bus.stochastic_ukf import Received
from concord.filters.gaussian import Gaussian
from concord.nodes.lanes.filter import Counters, added, received, traffic
from concord.nodes.lanes.links import Links


class ReceptionContent(NamedTuple):
    """Sensors and receivers of R runs between two cycles.

    step: of all. state: that of the receivers. readings (R, m): of all sensors. sent (R, m): what
    sensors take the receivers to hold. held (R, m): what receivers hold. ages (R, N): slots since
    each sensor was heard. counters: totals.
    """

    step: int
    state: Any
    readings: np.ndarray
    sent: np.ndarray
    held: np.ndarray
    ages: np.ndarray
    counters: Counters


@dataclass(frozen=True)
class BatchedReception:
    """`concord.nodes.lanes.network.BatchedRule` of a measurement bus.

    first_held (m,): values that receivers hold at first. The first slot is in step `first_slot`.
    """

    receiver: Receiver
    bus: MeasurementBus
    first_held: np.ndarray
    codec: MeasurementCodec
    links: Links
    first_slot: int

    def start(self, prior: Gaussian) -> ReceptionContent:
        """Nothing read, nothing sent."""
        runs = len(prior.mean)
        held = np.broadcast_to(self.first_held, (runs, len(self.first_held)))
        never = np.full((runs, len(self.bus.sizes)), -1)
        state = self.receiver.start((runs,))
        return ReceptionContent(0, state, np.full(held.shape, np.nan), held, held, never, {})

    def begin_step(
        self, content: ReceptionContent, readings: np.ndarray, control: np.ndarray | None, step: int
    ) -> ReceptionContent:
        """Predict, and take the readings (R, 1 + N, 1, d)."""
        taken = [
            readings[:, sensor, 0, :size] for sensor, size in enumerate(self.bus.sizes, start=1)
        ]
        content = content._replace(step=step, readings=np.concatenate(taken, axis=-1))
        if step == 0:
            return content
        moved = self.receiver.predict(content.state, control, step)
        counters = self._counted(content, moved, "predict-failed")
        return content._replace(state=moved, counters=counters)

    def bids(self, content: ReceptionContent, nodes: np.ndarray) -> np.ndarray:
        """How urgent a dynamic slot is to these nodes (C,): integers (R, C)."""
        bids = self.bus.bids(content.step, content.readings, content.sent)
        return np.where(bids < 0, NO_BID, bids)[:, nodes - 1]

    def exchange(
        self, content: ReceptionContent, sends: np.ndarray, lost: np.ndarray | None
    ) -> ReceptionContent:
        """A slot, in which sensors `sends` (R, 1 + N) transmit and the receivers update."""
        none = np.zeros_like(sends)
        counters = added(content.counters, traffic(self.links, sends, none, lost, "measurement"))
        content = content._replace(counters=counters)
        if content.step < self.first_slot:
            return content
        values = received(content.readings, self.codec.number)
        whole = self._each(~np.isnan(values), np.logical_and)
        came = self.links.arriving(sends, lost)[:, : len(self.bus.sizes)] & whole
        spoke = sends[:, 1:] & whole
        silent = self.bus.silent
        sent = np.where(self._wide(spoke), values, silent(content.sent))
        fresh = self._wide(came)
        held = np.where(fresh, values, silent(content.held))
        state = self.receiver.update(content.state, Received(held, fresh), content.step)
        older = np.where(content.ages < 0, -1, content.ages + 1)
        return content._replace(
            state=state,
            sent=sent,
            held=held,
            ages=np.where(came, 0, older),
            counters=self._counted(content, state, self.receiver.failure),
        )

    def belief(self, content: ReceptionContent) -> Gaussian:
        """Return the beliefs: those of the receivers, and NaN for the sensors."""
        own = self.receiver.belief(content.state)
        runs, n = own.mean.shape
        mean = np.full((runs, self.links.nodes, n), np.nan)
        cov = np.full((runs, self.links.nodes, n, n), np.nan)
        mean[:, RECEIVER], cov[:, RECEIVER] = own
        return Gaussian(mean, cov)

    def ages(self, content: ReceptionContent) -> np.ndarray:
        """Slots since each sensor was heard by the receiver (R, E); -1 never."""
        deaf = np.full((len(content.ages), len(self.links.sender) - content.ages.shape[1]), -1)
        return np.concatenate([content.ages, deaf], axis=-1)

    def counters(self, content: ReceptionContent) -> Counters:
        """Return the totals since the start."""
        return content.counters

    def spread(self, content: ReceptionContent) -> None:
        """Shares have one length."""
        return

    def _wide(self, sensors: np.ndarray) -> np.ndarray:
        """Flags (R, N) of sensors for each entry of their measurements (R, m)."""
        return np.repeat(sensors, self.bus.sizes, axis=-1)

    def _each(self, entries: np.ndarray, join: np.ufunc) -> np.ndarray:
        """Flags (R, m) of entries joined for each sensor (R, N)."""
        starts = [self.bus.rows(sensor).start for sensor in range(1, len(self.bus.sizes) + 1)]
        return join.reduceat(entries, starts, axis=-1)

    def _counted(self, content: ReceptionContent, after: Any, name: str) -> Counters:
        """The counters, one more where a belief has just stopped being a number."""
        now, before = (
            np.asarray(np.isfinite(self.receiver.belief(state).cov).all((-1, -2)))
            for state in (after, content.state)
        )
        failed = np.zeros((len(now), self.links.nodes), dtype=np.int64)
        failed[:, RECEIVER] = before & ~now
        return added(content.counters, {name: failed})
