"""A bus of slots with frame IDs: shares in FlexRay frames, and slots awarded by an arbiter."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Arbiter, ArbiterState, Fits, award
from concord.bus.bus import Fragment, Rejected, SharePlace
from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import (
    SHARE_FRAMES,
    frame_payloads,
    in_slot,
    numbered,
    read_frame,
    renumbered,
    to_frames,
    whole_body,
)
from concord.bus.schedule import Schedule

Slots = Callable[[int, int], tuple[Slot, ...]]
"""(node, cycle) -> the slots of the node's share in that cycle."""


class SlottedBus:
    """The part of `concord.bus.bus.Bus` that needs no time: it gives each share consecutive
    slots."""

    frame_format = SHARE_FRAMES

    def __init__(
        self, schedule: Schedule, slots: Slots, arbiter: Arbiter, cycle_counts: int
    ) -> None:
        self.schedule = schedule
        self.slots = slots
        self._arbiter = arbiter
        self._cycle_counts = cycle_counts

    def encode(self, node: int, cycle: int, body: bytes) -> list[bytes]:
        """Return the frames in which a node sends a share in a cycle."""
        return to_frames(body, cycle, self.slots(node, cycle), self._cycle_counts)

    def payloads(self, node: int, cycle: int, body_bytes: int) -> tuple[int, ...]:
        """Return the payload length of each frame that `encode` makes of a body of that length."""
        return frame_payloads(body_bytes, self.slots(node, cycle))

    def due_body(self, frame: bytes, sender: int, cycle: int, body_bytes: int) -> bytes | None:
        """Return the body in a frame that is bit by bit what `encode` makes; None for others."""
        slot = self.slots(sender, cycle)[0]
        return whole_body(frame, slot, body_bytes, cycle, self._cycle_counts)

    def receive(self, frame: bytes) -> Fragment:
        """Return what a frame carries; raise `Rejected` for one that is not sound."""
        return read_frame(frame, self._cycle_counts)

    def place(self, sender: int, fragment: Fragment) -> SharePlace:
        """Return where a fragment belongs in its share; raise `Rejected` if nowhere."""
        frames = numbered(fragment.data).frames
        schedule, cycle = self.schedule, fragment.cycle
        if sender not in schedule.static_senders(cycle) and sender not in schedule.contenders(
            cycle
        ):
            raise Rejected("unscheduled")
        # A share takes the first of its sender's slots, as many as it needs.
        for number, slot in enumerate(self.slots(sender, cycle)[:frames]):
            if slot.frame_id == fragment.frame_id:
                return SharePlace(number, frames)
        raise Rejected("wrong-slot")

    def in_slot_of(self, frame: bytes, node: int, cycle: int) -> bytes | None:
        """Return a sound frame moved to the first slot of a node; None where it has no slot."""
        slots = self.slots(node, cycle)
        return in_slot(frame, slots[0].frame_id) if slots else None

    def renumbered(self, frame: bytes, cycle: int) -> bytes:
        """Return a sound frame with the number of another cycle."""
        return renumbered(frame, cycle, self._cycle_counts)

    def arbitrate(
        self,
        state: ArbiterState,
        cycle: int,
        group: int,
        nodes: Sequence[int] | NDArray[np.int64],
        bids: NDArray[np.int64],
        payload_bytes: NDArray[np.int64],
    ) -> tuple[ArbiterState, NDArray[np.bool_]]:
        """Award the slots of one group of a cycle (`concord.bus.bus.Bus.arbitrate`)."""
        frame_ids = np.array(
            [self.slots(int(node), cycle)[0].frame_id for node in nodes], dtype=np.int64
        )
        slots = self.schedule.groups(cycle)[group].dynamic_slots
        fits = self._fits(nodes, frame_ids, payload_bytes)
        return award(self._arbiter, state, nodes, frame_ids, bids, slots, fits)

    def _fits(
        self,
        nodes: Sequence[int] | NDArray[np.int64],
        frame_ids: NDArray[np.int64],
        payload_bytes: NDArray[np.int64],
    ) -> Fits | None:
        """Return whether requests fit beside each other; None where all that may win do."""
        return None
