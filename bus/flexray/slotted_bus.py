"""A bus of slots with frame IDs: shares in FlexRay frames, and slots awarded by an arbiter."""

from collections.abc import Callable, Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import (
    NO_BID,
    Arbiter,
    ArbiterState,
    Fits,
    LosingBids,
    UrgencyClasses,
    award,
    largest_bid,
    unclassed,
)
from concord.bus.bus import Awards, Fragment, Rejected, SharePlace
from concord.bus.contended_bus import ContendedBus
from concord.bus.flexray.cut_shares import SentFrames
from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import (
    SHARE_FRAMES,
    frame_id_of,
    frame_payloads,
    in_slot,
    read_frame,
    renumbered,
    to_frames,
    whole_body,
)
from concord.bus.fragments import numbered
from concord.bus.schedule import Schedule
from concord.bus.timebase import EVERY_CYCLE, Pace, Timebase, at_pace

Slots = Callable[[int, int], tuple[tuple[Slot, ...], ...]]
"""(node, cycle) -> for each urgency class the slots of the node's share in that cycle; one class
for a node with slots of its own, none for a node without slots."""

_NOT_COUNTED = -1, 0


class SlottedBus(ContendedBus):
    """The part of `concord.bus.bus.Bus` that needs no time: it gives each share consecutive
    slots."""

    frame_format = SHARE_FRAMES
    timebase: Timebase = EVERY_CYCLE
    cycle_us: float = 0.0

    def __init__(
        self,
        schedule: Schedule,
        slots: Slots,
        arbiter: Arbiter,
        cycle_counts: int,
        classes: UrgencyClasses,
    ) -> None:
        self.schedule = schedule
        self.slots = slots
        self.classes = classes
        self._arbiter = arbiter
        self._cycle_counts = cycle_counts
        self._counted = _NOT_COUNTED

    def paced(self, pace: Pace) -> Self:
        """Return the bus in a run of this pace: which of its cycles carry rounds."""
        other = at_pace(self, pace, self.schedule.period)
        other._counted = _NOT_COUNTED
        return other

    def cycle_count(self, cycle: int) -> int:
        """Return the cycle counter of the bus in the cycle that nodes call `cycle`."""
        # Kept: every frame of a cycle asks.
        known, count = self._counted
        if known != cycle:
            count = self.timebase.bus_cycle(cycle) % self._cycle_counts
            self._counted = cycle, count
        return count

    def encode(self, node: int, cycle: int, body: bytes, urgency_class: int = 0) -> list[bytes]:
        """Return the frames in which a node sends a share in a cycle."""
        slots = self.slots(node, cycle)
        of_class = slots[min(urgency_class, len(slots) - 1)]
        return to_frames(body, cycle, of_class, self.cycle_count(cycle))

    def payloads(self, node: int, cycle: int, body_bytes: int) -> tuple[int, ...]:
        """Return the payload length of each frame that `encode` makes of a body of that length."""
        return frame_payloads(body_bytes, self.slots(node, cycle)[0])

    def due_body(self, frame: bytes, sender: int, cycle: int, body_bytes: int) -> bytes | None:
        """Return the body in a frame that is bit by bit what `encode` makes; None for others."""
        slots = self.slots(sender, cycle)
        slot = slots[0][0]
        if len(slots) > 1:
            sent_in = frame_id_of(frame)
            slot = next((one[0] for one in slots if one[0].frame_id == sent_in), slot)
        return whole_body(frame, slot, body_bytes, cycle, self.cycle_count(cycle))

    def receive(self, frame: bytes) -> Fragment:
        """Return what a frame carries; raise `Rejected` for one that is not sound."""
        return read_frame(frame)

    def place(self, sender: int, fragment: Fragment) -> SharePlace:
        """Return where a fragment belongs in its share; raise `Rejected` if nowhere."""
        schedule, cycle = self.schedule, fragment.cycle
        if fragment.count not in (None, self.cycle_count(cycle)):
            raise Rejected("cycle-count")
        frames = numbered(fragment.data).frames
        if sender not in schedule.static_senders(cycle) and sender not in schedule.contenders(
            cycle
        ):
            raise Rejected("unscheduled")
        # A share takes the first slots of a class of its sender, as many as it needs.
        for of_class in self.slots(sender, cycle):
            for number, slot in enumerate(of_class[:frames]):
                owned = slot.frame_id, slot.checksum_channel
                if owned == (fragment.frame_id, fragment.channel):
                    return SharePlace(number, frames, slot.channel)
        raise Rejected("wrong-slot")

    def urgency_class(self, node: int, cycle: int, frame_id: int) -> int:
        """Return the class of a node's frame ID; 0 for an ID that is not the node's."""
        for number, of_class in enumerate(self.slots(node, cycle)):
            if any(slot.frame_id == frame_id for slot in of_class):
                return number
        return 0

    def in_slot_of(self, frame: bytes, node: int, cycle: int) -> bytes | None:
        """Return a sound frame moved to the first slot of a node; None where it has no slot."""
        slots = self.slots(node, cycle)
        if not slots:
            return None
        slot = slots[0][0]
        return in_slot(frame, slot.frame_id, slot.checksum_channel)

    def renumbered(self, frame: bytes, cycle: int) -> bytes:
        """Return a sound frame with the number of another cycle."""
        return renumbered(frame, cycle, self.cycle_count(cycle))

    @property
    def has_ideal_arbiter(self) -> bool:
        """Whether slots are awarded in an order that no controller knows."""
        return self._arbiter.is_ideal

    @property
    def losing_bids(self) -> LosingBids | None:
        """The largest bids that losers may have beside a winner's; None where bids do not count."""
        return unclassed if self._arbiter.urgency is largest_bid else None

    def arbitrate(
        self,
        state: ArbiterState,
        cycle: int,
        group: int,
        nodes: Sequence[int] | NDArray[np.int64],
        bids: NDArray[np.int64],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> Awards:
        """Award the slots of one group of a cycle (`concord.bus.bus.Bus.arbitrate`)."""
        places = np.asarray(nodes, dtype=np.int64)
        slots = [self.slots(node, cycle) for node in places.tolist()]
        ids = [[of_class[0].frame_id for of_class in of_node] for of_node in slots]
        owned = np.array(ids, dtype=np.int64).reshape(len(slots), self.classes.count)
        groups = self.schedule.groups(cycle)
        most = groups[group].dynamic_slots
        if not (self._arbiter.withdraws or self.schedule.relay):
            most = len(slots)
        classes = self.classes.of(bids, state.waits[..., places])
        passed = None
        if self.schedule.relay and self.classes.count > 1:
            begins = not any(one.dynamic_slots for one in groups[:group])
            last = np.where(begins, 0, state.last_frame_id)
            # Of a class whose slot is over, a host takes the next ID of its node.
            over = (owned <= last[..., None, None]).sum(axis=-1)
            passed = over == self.classes.count
            classes = np.minimum(np.maximum(classes, over), self.classes.count - 1)
            state = state._replace(last_frame_id=last)
        frame_ids = owned[np.arange(len(slots)), classes]
        sent = self._sent_frames(places, frame_ids, bids != NO_BID, payload_bytes)
        fits = self._fits(places, frame_ids, payload_bytes) if sent is None else sent.fits
        ranks = self._ranks(places, frame_ids)
        state, wins = award(self._arbiter, state, places, ranks, bids, most, fits, passed)
        return Awards(state, wins, classes, None if sent is None else sent.cut)

    def _ranks(self, nodes: NDArray[np.int64], frame_ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return numbers (..., C) in the order of the frame IDs, each of one contender."""
        return frame_ids

    def _fits(
        self,
        nodes: NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> Fits | None:
        """Return whether requests fit beside each other; None where all that may win do."""
        return None

    def _sent_frames(
        self,
        nodes: NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        asks: NDArray[np.bool_],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> SentFrames | None:
        """Return the frames that go of each share; None where shares go whole or not at all."""
        return None
