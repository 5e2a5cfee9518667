"""The measurement bus: sensors 1..N share one bus to a receiver, node 0; one slot per step.

Slot s >= 1 is cycle s of a `Schedule` with one node at most per row. The receiver holds the last
measurement of every silent sensor (or takes it to be zero). Sensors that contend for a slot ask
with the weighted squared change since their last transmission (weighted try-once-discard).

Source: Meng et al. (2025), UKF for nonlinear systems with stochastic nonlinearities under FlexRay
protocol, equations (2) to (5), the plain rule; a test holds it against the matrices (6) to (9).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import LosingBids
from concord.bus.schedule import Schedule

RECEIVER = 0
Row = TypeVar("Row")
# Bits of a float64's fraction that a bid keeps: enough to order any two readings that a sensor can
# tell apart, too few for the last bit of a sum.
_FRACTION_BITS = 30
BID_RESOLUTION = 2.0**-_FRACTION_BITS
"""Two changes whose ratio is closer to 1 than this may have the same bid."""
_DROPPED_BITS = 52 - _FRACTION_BITS
_ONE = 1023 << _FRACTION_BITS
_OCTAVES = 64
_INFINITE = 2047 << _FRACTION_BITS
_ROUNDING = 2.0**-48
BID_SPAN = (_ONE - (_OCTAVES << _FRACTION_BITS), _ONE + (_OCTAVES << _FRACTION_BITS))
"""Bids of squared changes from 2^-64 to 2^64: equal steps between them are equal ratios."""


WeightsAt = Callable[[int], Sequence[np.ndarray]]
"""slot -> the weights Q_j (m_j, m_j) of all sensors in it."""


def zero_order_hold(received: np.ndarray) -> np.ndarray:
    """Return the assumed measurement of a silent sensor: the last value that it sent."""
    return received


def zero_input(received: np.ndarray) -> np.ndarray:
    """Return the assumed measurement of a silent sensor: zero."""
    return np.zeros_like(received)


class SlotOutcome(NamedTuple):
    """Knowledge of the receiver after a slot.

    Attributes:
        sent: (..., N), which sensors transmitted in this slot.
        fresh: (..., m), the same for the entries of the measurement.
        received: (..., m), ybar: the fresh measurement, and what silent sensors are taken to say.
    """

    sent: NDArray[np.bool_]
    fresh: NDArray[np.bool_]
    received: np.ndarray


@dataclass(frozen=True, eq=False)
class MeasurementBus:
    """N sensors with `sizes` m_1..m_N, whose measurements (..., m) are stacked in their order.

    `schedule` is one of the four below, or any other for N + 1 nodes in which node 0 is silent.
    `weights` are the Q_j (m_j, m_j) of (4), the same in every slot or a function of the slot; the
    identity unless given.

    Raises:
        ValueError: a size below one, weights or a schedule that do not fit the sensors.
    """

    sizes: tuple[int, ...]
    schedule: Schedule
    weights: tuple[np.ndarray, ...] | WeightsAt = ()
    silent: Callable[[np.ndarray], np.ndarray] = zero_order_hold

    def __post_init__(self) -> None:
        if not self.sizes or min(self.sizes) < 1:
            raise ValueError(f"sizes {self.sizes}: give one size per sensor, each at least 1")
        if self.schedule.nodes != len(self.sizes) + 1:
            raise ValueError(
                f"a schedule for {self.schedule.nodes} nodes on a measurement bus with "
                f"{len(self.sizes)} sensors; it needs one node per sensor, and node 0 for the "
                "receiver"
            )
        for row in (*self.schedule.static_table, *self.schedule.contender_table):
            if RECEIVER in row:
                raise ValueError("node 0 of a measurement bus receives; leave it out of all turns")
        # A function of the slot is tried once, before anything starts.
        weights = self.weights_at(0)
        if len(weights) != len(self.sizes):
            raise ValueError(
                f"{len(weights)} weights for {len(self.sizes)} sensors; give one matrix per "
                "sensor, or none for the identity"
            )
        for sensor, (weight, size) in enumerate(zip(weights, self.sizes, strict=True), 1):
            if np.shape(weight) != (size, size):
                raise ValueError(
                    f"the weight of sensor {sensor} has shape {np.shape(weight)}, but its "
                    f"measurement has {size} entries; give a matrix ({size}, {size})"
                )
            least = np.linalg.eigvalsh(weight + weight.T)[0] / 2
            if least < -1e-12 * np.abs(weight).max():
                raise ValueError(
                    f"the weight of sensor {sensor} has the eigenvalue {least:.3g}; give a matrix "
                    "without negative ones, so that a larger change never bids less"
                )

    @property
    def entries(self) -> int:
        """Length m of all measurements together."""
        return sum(self.sizes)

    def rows(self, sensor: int) -> slice:
        """Where the measurement of a sensor (1..N) is among all."""
        return list(_slices(self.sizes))[sensor - 1]

    def transmit(self, slot: int, measurement: np.ndarray, received: np.ndarray) -> SlotOutcome:
        """One slot of the bus: (2) to (5).

        Args:
            slot: s, counted from 1 on; in slot 0 nothing has been measured yet.
            measurement: y_s (..., m); a sensor with a NaN entry has nothing to send.
            received: ybar_{s-1} (..., m).
        """
        able = np.stack(
            [~np.isnan(measurement[..., rows]).any(axis=-1) for rows in _slices(self.sizes)], -1
        )
        sent = np.zeros(able.shape, dtype=bool)
        for node in self.schedule.static_senders(slot):
            sent[..., node - 1] = True
        contenders = [node - 1 for node in self.schedule.contenders(slot)]
        if contenders:
            bids = self.bids(slot, measurement, received)[..., contenders]
            # Largest first, the lowest node among equals.
            ranks = np.argsort(np.argsort(-bids, axis=-1, kind="stable"), axis=-1)
            sent[..., contenders] = ranks < self.schedule.dynamic_slots(slot)
        sent &= able
        fresh = np.repeat(sent, self.sizes, axis=-1)
        return SlotOutcome(sent, fresh, np.where(fresh, measurement, self.silent(received)))

    def bids(self, slot: int, measurement: np.ndarray, received: np.ndarray) -> np.ndarray:
        """The bid of every sensor (..., N), whole numbers; -1 where it has nothing to send."""
        change = measurement - received
        return np.stack(
            [
                bid(change[..., rows], weight)
                for rows, weight in zip(_slices(self.sizes), self.weights_at(slot), strict=True)
            ],
            axis=-1,
        )

    def weights_at(self, slot: int) -> tuple[np.ndarray, ...]:
        """The weights Q_j (m_j, m_j) of all sensors in a slot."""
        if callable(self.weights):
            return tuple(self.weights(slot))
        return self.weights or tuple(np.eye(size) for size in self.sizes)


def bid(change: np.ndarray, weight: np.ndarray) -> NDArray[np.int64]:
    """The bid (...) of a change (..., m_j) since the last transmission; -1 where an entry is NaN.

    It is the float64 change' Q_j change without the last bits of its fraction, read as an integer.
    The order of positive floats is that of these integers, so the largest change wins in any unit.
    Changes within `BID_RESOLUTION` of each other may tie: no winner depends on the last bit.
    """
    urgency = (change * (change @ weight)).sum(axis=-1)
    # Adding zero turns a negative zero, whose integer is negative, into a positive one.
    bits = (np.maximum(urgency, 0.0) + 0.0).view(np.int64) >> _DROPPED_BITS
    return np.where(np.isnan(urgency), -1, bits)


def largest_change(bids: np.ndarray) -> np.ndarray:
    """The upper bound (...) of change' Q_j change over all changes with these bids or lower ones.

    A receiver that computes the winner's bid knows that the weighted squared change of no loser is
    larger. The bound covers the rounding of the sum in the bid. 0 for bids below 0.
    """
    above = np.clip(np.asarray(bids, dtype=np.int64) + 1, 0, _INFINITE) << _DROPPED_BITS
    return above.view(np.float64) * (1.0 + _ROUNDING)


@runtime_checkable
class AwardsByBid(Protocol):
    """A bus (`concord.bus.bus.Bus`) that can tell what a winner's bid says of the others."""

    @property
    def losing_bids(self) -> LosingBids | None:
        """The largest bids beside a winner's; None where slots are not awarded by bids."""
        ...


def losing_bids_of(bus: object) -> LosingBids | None:
    """Return what a winner's bid on a bus says of the others; None where it says nothing."""
    return bus.losing_bids if isinstance(bus, AwardsByBid) else None


def flexray(sensors: int, static_slots: int, first: int = 1) -> Schedule:
    """Cycles of l + 1 slots: sensors 1..l in turn, then one slot for which l+1..N contend.

    Source: (2) and (4) with q = ceil(s / l1). The turn of sensor 1 is in slot `first`: 1 as printed
    by Meng et al., 0 as in Liu et al. (2021). With l = N no sensor contends, and each cycle ends
    with an empty slot.

    Raises:
        ValueError: `static_slots` is not in 0..sensors.
    """
    if not 0 <= static_slots <= sensors:
        raise ValueError(
            f"{static_slots} static slots for {sensors} sensors; take 0 to {sensors}, one for "
            "each sensor at most"
        )
    turns = _begun(((*((node,) for node in range(1, static_slots + 1)), ())), first)
    dynamic = _begun((*(0,) * static_slots, 1), first)
    contenders = tuple(range(static_slots + 1, sensors + 1))
    return Schedule(sensors + 1, turns, (contenders,), dynamic)


def round_robin(sensors: int, members: Sequence[int], first: int = 1) -> Schedule:
    """The members of 1..sensors in turn, one per slot; the first of them sends in slot `first`."""
    return Schedule(sensors + 1, _begun(tuple((node,) for node in members), first))


def try_once_discard(sensors: int, members: Sequence[int]) -> Schedule:
    """Every slot to the member of 1..sensors whose measurement has changed most."""
    return Schedule(sensors + 1, ((),), (tuple(members),), (1,))


def all_at_once(sensors: int) -> Schedule:
    """Every sensor in every slot: no bus, for comparison."""
    return Schedule(sensors + 1, (tuple(range(1, sensors + 1)),))


def nobody(sensors: int) -> Schedule:
    """No sensor ever: prediction alone, for comparison."""
    return Schedule(sensors + 1, ((),))


def _begun(rows: tuple[Row, ...], first: int) -> tuple[Row, ...]:
    """Rows of which the first one belongs to slot `first` and is repeated from there on."""
    turned = -first % len(rows)
    return (*rows[turned:], *rows[:turned])


def _slices(sizes: Sequence[int]) -> list[slice]:
    return [slice(*ends) for ends in pairwise(accumulate(sizes, initial=0))]
