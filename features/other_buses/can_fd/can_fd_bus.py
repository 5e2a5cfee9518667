"""The bus of a network on CAN FD: shares arbitrate by the identifiers of their frames."""

from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from itertools import zip_longest

from concord.bus.arbitration import Arbiter, LosingBids, largest_bid, lowest_frame_id
from concord.bus.bus import Transmission
from concord.bus.schedule import Schedule
from concord.features.other_buses.can_fd.bits import (
    ERROR_FRAME_BITS,
    IDENTIFIER_BITS,
    INTERMISSION_BITS,
    FrameBits,
    Rates,
    longest_bits,
)
from concord.features.other_buses.can_fd.frame import FRAMINGS
from concord.features.other_buses.can_fd.priority import BidLevels, layout
from concord.features.other_buses.can_fd.response_times import Message, response_times
from concord.features.other_buses.identified_bus import BidClasses, IdentifiedBus
from concord.features.other_buses.identified_frames import frame_id_of
from concord.features.other_buses.options import CanFd
from concord.scenarios.bus_table.bus_definition import BusDefinition, BusRequest

# The bid itself is in the identifier, so controllers do what the ideal arbiter says.
_BY_BID = Arbiter(lowest_frame_id, by_class=True, is_ideal=False)


class CanFdBus(IdentifiedBus):
    """A schedule on CAN FD (`concord.bus.bus.Bus`).

    All shares of a cycle ask for the bus at its beginning and are sent in the order of their
    identifiers. Frames count with the most stuff bits, so that times depend on lengths alone.

    A frame that ends in an error is sent again, `retransmissions` times at most. No waiting frame
    has a lower identifier, so it wins the next arbitration. An error counts as if it came with the
    last bit of the frame, and each error frame has its greatest length.
    """

    name = "can-fd"
    segment_name = "arbitration"

    def __init__(
        self,
        schedule: Schedule,
        share_bytes: int,
        arbiter: Arbiter,
        classes: BidClasses,
        rates: Rates,
        retransmissions: int = 0,
    ) -> None:
        framing = FRAMINGS[rates.identifier_bits]
        super().__init__(schedule, share_bytes, framing, arbiter, classes)
        self.rates = rates
        self.retransmissions = retransmissions
        self._layout = layout(schedule.nodes, rates.identifier_bits, classes.count)

    def identifiers(self, node: int, cycle: int) -> range:
        """Return the node's identifiers: one as the owner of a turn, else one for each class."""
        if node in self.schedule.static_senders(cycle):
            return self._layout.of_owner(node)
        if node in self.schedule.contenders(cycle):
            return self._layout.of_contender(node, self.classes.count)
        return range(0)

    @property
    def losing_bids(self) -> LosingBids | None:
        """The largest bids that losers may have beside a winner's; None where bids do not count."""
        return self.classes.largest if isinstance(self.classes, BidLevels) else None

    def frame_us(self, size: int) -> Fraction:
        """Return the longest time of a frame with so many data bytes, without intermission."""
        return self.rates.us(longest_bits(self.rates.identifier_bits, size))

    def failed_us(self, payload_bytes: int) -> float:
        """Return the time of a frame that ends in an error, until the next one may begin."""
        return float(self._failed_us(payload_bytes))

    def delays_us(self, cycle: Sequence[Transmission], failed: Sequence[int]) -> tuple[float, ...]:
        """Return the delays of frames by errors (`concord.bus.bus.Retransmits`)."""
        found: list[float] = []
        late_us = 0.0
        for frame, tries in zip(cycle, failed, strict=True):
            found.append(late_us)
            late_us += tries * self.failed_us(frame.payload_bytes)
            if tries > self.retransmissions:
                # No try of this frame was without an error.
                late_us -= frame.end_us - frame.start_us + float(self._intermission_us)
        return tuple(found)

    def _failed_us(self, size: int) -> Fraction:
        error = self.rates.us(FrameBits(ERROR_FRAME_BITS + INTERMISSION_BITS, 0))
        return self.frame_us(size) + error

    def cycle_of_senders_us(self, senders: int) -> float:
        """Return the time in which so many nodes send their longest shares."""
        return float(senders * self._share_us)

    @property
    def worst_access_us(self) -> float:
        """The longest response time of a share, of nodes that send one in each cycle."""
        return self._worst_access_us

    @cached_property
    def _worst_access_us(self) -> float:
        senders = round(self.cycle_us / float(self._share_us))
        period = senders * self._share_us
        times = [self._tries_us(size) for size in self._longest] * senders
        messages = [Message(place, time, period) for place, time in enumerate(times)]
        bit_us = self.rates.us(FrameBits(1, 0))
        worst = [one.worst_us for one in response_times(messages, bit_us)]
        return float(max(one for one in worst if one is not None))

    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one."""
        owners = self.schedule.static_senders(cycle)
        asked = enumerate(zip_longest(payload_bytes, classes, fillvalue=0))
        ready = sorted(
            (identifiers[urgency_class], node, size)
            for node, (size, urgency_class) in asked
            if size and urgency_class < len(identifiers := self.identifiers(node, cycle))
        )
        sent: list[Transmission] = []
        now = Fraction(0)
        for identifier, node, share in ready:
            segment = "static" if node in owners else "dynamic"
            for number, size in enumerate(self.split_payload(share)):
                start, now = now, now + self.frame_us(size)
                sent.append(
                    Transmission(
                        node,
                        frame_id_of(identifier, number),
                        "A",
                        segment,
                        size,
                        float(start),
                        float(now),
                    )
                )
                now += self._intermission_us
        return tuple(sent)

    @cached_property
    def _intermission_us(self) -> Fraction:
        return self.rates.us(FrameBits(INTERMISSION_BITS, 0))

    @cached_property
    def _share_us(self) -> Fraction:
        return sum(map(self._tries_us, self._longest), Fraction(0))

    def _tries_us(self, size: int) -> Fraction:
        """The longest time of a frame with all its tries, until the next frame may begin."""
        failed_us = self.retransmissions * self._failed_us(size)
        return failed_us + self.frame_us(size) + self._intermission_us


def can_fd_bus(
    schedule: Schedule,
    share_bytes: int,
    arbiter: Arbiter,
    classes: BidClasses,
    rates: Rates,
    bid_span: tuple[int, int] | None = None,
    retransmissions: int = 0,
) -> CanFdBus:
    """Return the bus of a schedule whose shares have at most that many bytes.

    bid_span: least and largest bid, where bids are logarithms (`BidLevels`).
    retransmissions: how often a frame is sent again after an error, at most.

    Raises:
        ValueError: the data rate is below the nominal one, or identifiers are too short.
    """
    if rates.data_kbit_s < rates.nominal_kbit_s:
        raise ValueError(
            f"--bus can-fd --data-kbit-s {rates.data_kbit_s}: must be at least --nominal-kbit-s "
            f"{rates.nominal_kbit_s}; raise the one or lower the other"
        )
    if arbiter.urgency is largest_bid and any(schedule.dynamic_slot_table):
        levels = layout(schedule.nodes, rates.identifier_bits, 1).levels
        arbiter, classes = _BY_BID, BidLevels(levels, bid_span)
    return CanFdBus(schedule, share_bytes, arbiter, classes, rates, retransmissions)


def _can_fd(chosen: CanFd, asked: BusRequest) -> CanFdBus:
    bits = IDENTIFIER_BITS[chosen.identifiers]
    rates = Rates(bits, chosen.nominal_kbit_s, chosen.data_kbit_s)
    return can_fd_bus(
        asked.schedule,
        asked.share_bytes,
        asked.arbiter,
        asked.classes,
        rates,
        asked.bid_span,
        chosen.retransmissions,
    )


DEFINITION = BusDefinition(
    _can_fd, lambda chosen: FRAMINGS[IDENTIFIER_BITS[chosen.identifiers]].frame_format()
)
