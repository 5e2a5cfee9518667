"""A bus without time: the schedule holds, every frame arrives, and no cycle takes any time.

Its frames are those of FlexRay, so that runs with and without time differ by time alone.
"""

from collections.abc import Sequence
from math import nan

from concord.bus.arbitration import ARBITERS, ONE_CLASS, Arbiter
from concord.bus.bus import SegmentTime, Transmission
from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import CYCLE_COUNTS, payload_lengths
from concord.bus.flexray.slotted_bus import SlottedBus
from concord.bus.schedule import Schedule


class TimelessBus(SlottedBus):
    """The bus whose cycles take no time and hold whatever the schedule lets in.

    Each node has consecutive frame IDs of its own in every cycle. The times of its frames are
    places: one share is drawn after the other, each of length 1.
    """

    name = "none"
    has_time = False
    cycle_us: float = 0.0
    channels = "A"
    clock_precision_us = 0.0
    worst_access_us = nan

    def __init__(
        self, schedule: Schedule, share_bytes: int, arbiter: Arbiter = ARBITERS["wtod"]
    ) -> None:
        lengths = payload_lengths(share_bytes)
        owned = [
            tuple(
                Slot(node * len(lengths) + 1 + part, length) for part, length in enumerate(lengths)
            )
            for node in range(schedule.nodes)
        ]
        super().__init__(
            schedule, lambda node, cycle: (owned[node],), arbiter, CYCLE_COUNTS, ONE_CLASS
        )

    def segments(self) -> tuple[SegmentTime, ...]:
        """Return one segment, in which each owner of a slot has a place of length 1."""
        owners = max(len(row) for row in self.schedule.static_table)
        return (SegmentTime("static", 0.0, float(max(owners, 1))),)

    def marks_us(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return no marks."""
        return (), ()

    def own_slot_us(self, node: int, cycle: int) -> tuple[float, float]:
        """Return the place of an owner among all owners of the cycle."""
        place = self.schedule.static_senders(cycle).index(node)
        return float(place), place + 1.0

    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the shares of the owners of slots, each as one frame in its place."""
        return tuple(
            Transmission(
                node, place + 1, "A", "static", payload_bytes[node], float(place), place + 1.0
            )
            for place, node in enumerate(self.schedule.static_senders(cycle))
            if payload_bytes[node]
        )

    def load(self, transmissions: Sequence[Transmission]) -> float:
        """Return NaN: there is no time to be busy in."""
        return nan

    def fusion_delay_us(self, rounds: int, last_cycle: Sequence[Transmission]) -> float:
        """Return NaN: there is no time to pass."""
        return nan

    def check_pace(self, rounds: int, time_step_s: float, stretch: float) -> None:
        """Accept every pace: cycles take no time."""
