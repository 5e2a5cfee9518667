"""A frame of a written slot table: who sends how much in which slot, and how often."""

import msgspec

from concord.bus.flexray.cluster_parameters import Channels


class MessageSlot(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame that a node sends: its ID, its cycles, its payload, and how often it is requested.

    It may be sent in the cycles with `cycle % repetition == base_cycle`. Requests come `period_us`
    apart at least; without it, once in each of its cycles. With `offset_us` they come at that time
    of the bus and exactly every `period_us` after it. `deadline_us` bounds the time from a request
    to the end of the frame; without it, nothing does. A node with dynamic frames of several urgency
    classes sends those of one class in a cycle.
    """

    frame_id: int
    payload_bytes: int
    node: int = 0
    channel: Channels = "A"
    base_cycle: int = 0
    repetition: int = 1
    period_us: float | None = None
    offset_us: float | None = None
    deadline_us: float | None = None
    urgency_class: int = 0

    def sends(self, cycle: int) -> bool:
        """Whether the frame may be sent in a cycle."""
        return cycle % self.repetition == self.base_cycle
