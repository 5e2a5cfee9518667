"""A bus whose frames carry identifiers of their senders, with a fixed time for each cycle."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from math import inf
from typing import Self

import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import Arbiter, ArbiterState, award
from concord.bus.bus import Awards, Fragment, Rejected, SegmentTime, SharePlace, Transmission
from concord.bus.contended_bus import BidClasses, ContendedBus
from concord.bus.fragments import numbered
from concord.bus.schedule import Schedule
from concord.bus.timebase import EVERY_CYCLE, Pace, Timebase, at_pace
from concord.features.other_buses.identified_frames import Framing, identifier_of


class IdentifiedBus(ContendedBus, ABC):
    """The part of `concord.bus.bus.Bus` that is the same for buses with identifiers.

    All shares of a cycle are ready at its beginning. A cycle lasts as long as the longest one that
    the schedule permits, so that each begins at a known time.
    """

    name: str
    segment_name: str
    timebase: Timebase = EVERY_CYCLE
    has_time = True
    channels = "A"
    # No slot has an edge that a clock could miss.
    clock_precision_us = inf

    def __init__(
        self,
        schedule: Schedule,
        share_bytes: int,
        framing: Framing,
        arbiter: Arbiter,
        classes: BidClasses,
    ) -> None:
        self.schedule = schedule
        self.frame_format = framing.frame_format()
        self.classes = classes
        self._framing = framing
        self._arbiter = arbiter
        self._longest = framing.sizes(share_bytes)

    # --- of each bus ------------------------------------------------------------------------------

    @abstractmethod
    def identifiers(self, node: int, cycle: int) -> range:
        """Return the identifier of a node in each urgency class; one for a node that owns a turn in
        this cycle, none for a node that may not send."""

    @abstractmethod
    def cycle_of_senders_us(self, senders: int) -> float:
        """Return the time in which so many nodes send their longest shares."""

    @abstractmethod
    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one."""

    # --- shares and frames ------------------------------------------------------------------------

    def encode(self, node: int, cycle: int, body: bytes, urgency_class: int = 0) -> list[bytes]:
        """Return the frames in which a node sends a share in a cycle."""
        identifiers = self.identifiers(node, cycle)
        identifier = identifiers[min(urgency_class, len(identifiers) - 1)]
        frames = self._framing.frames(body, cycle, identifier)
        if len(frames) > len(self._longest):
            raise ValueError(
                f"a share of {len(body)} bytes does not fit into {len(self._longest)} frames"
            )
        return frames

    def payloads(self, node: int, cycle: int, body_bytes: int) -> tuple[int, ...]:
        """Return the payload length of each frame that `encode` makes of a body of that length."""
        return self._framing.sizes(body_bytes)

    def due_body(self, frame: bytes, sender: int, cycle: int, body_bytes: int) -> bytes | None:
        """Return the body in a frame that is bit by bit what `encode` makes; None for others."""
        found = self._framing.whole_body(frame, cycle, body_bytes)
        if found is None or found[0] not in self.identifiers(sender, cycle):
            return None
        return found[1]

    def receive(self, frame: bytes) -> Fragment:
        """Return what a frame carries; raise `Rejected` for one that is not sound."""
        return self._framing.read(frame)

    def place(self, sender: int, fragment: Fragment) -> SharePlace:
        """Return where a fragment belongs in its share; raise `Rejected` if nowhere."""
        identifiers = self.identifiers(sender, fragment.cycle)
        if not identifiers:
            raise Rejected("unscheduled")
        place = numbered(fragment.data)
        known = place.number < place.frames <= len(self._longest)
        if not known or identifier_of(fragment.frame_id) not in identifiers:
            raise Rejected("wrong-slot")
        return place

    def urgency_class(self, node: int, cycle: int, frame_id: int) -> int:
        """Return the class of a node's frame ID; 0 for an ID that is not the node's."""
        identifiers, identifier = self.identifiers(node, cycle), identifier_of(frame_id)
        return identifiers.index(identifier) if identifier in identifiers else 0

    def in_slot_of(self, frame: bytes, node: int, cycle: int) -> bytes | None:
        """Return a sound frame under the name of a node; None where it may not send."""
        identifiers = self.identifiers(node, cycle)
        return self._framing.identified(frame, identifiers[0]) if identifiers else None

    def renumbered(self, frame: bytes, cycle: int) -> bytes:
        """Return a sound frame with the number of another cycle."""
        return self._framing.renumbered(frame, cycle)

    # --- awarded turns ----------------------------------------------------------------------------

    @property
    def has_ideal_arbiter(self) -> bool:
        """Whether turns are awarded in an order that no controller knows."""
        return self._arbiter.is_ideal

    def arbitrate(
        self,
        state: ArbiterState,
        cycle: int,
        group: int,
        nodes: Sequence[int] | NDArray[np.int64],
        bids: NDArray[np.int64],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> Awards:
        """Award the turns of one group of a cycle (`concord.bus.bus.Bus.arbitrate`)."""
        places = np.asarray(nodes, dtype=np.int64)
        owned = [self.identifiers(node, cycle) for node in places.tolist()]
        slots = self.schedule.groups(cycle)[group].dynamic_slots
        most = slots if self._arbiter.withdraws else len(owned)
        classes = self.classes.of(bids, state.waits[..., places])
        first = np.array([one.start for one in owned], dtype=np.int64)
        step = np.array([one.step for one in owned], dtype=np.int64)
        ids = first + step * classes
        state, wins = award(self._arbiter, state, places, ids, bids, most)
        return Awards(state, wins, classes)

    def _most_senders(self, cycle: int) -> int:
        contenders = len(self.schedule.contenders(cycle))
        if self._arbiter.withdraws:
            contenders = min(contenders, self.schedule.dynamic_slots(cycle))
        return len(self.schedule.static_senders(cycle)) + contenders

    # --- time -------------------------------------------------------------------------------------

    def paced(self, pace: Pace) -> Self:
        """Return the bus in a run: frames name their senders, so no step waits for a turn."""
        return at_pace(self, pace, period=1)

    @property
    def cycle_us(self) -> float:
        """The longest cycle that the schedule permits."""
        return self._cycle_us

    @cached_property
    def _cycle_us(self) -> float:
        most = max(self._most_senders(cycle) for cycle in range(self.schedule.period))
        return self.cycle_of_senders_us(max(1, most))

    def segments(self) -> tuple[SegmentTime, ...]:
        """Return one segment, the whole cycle."""
        return (SegmentTime(self.segment_name, 0.0, self.cycle_us),)

    def marks_us(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return no marks: a frame begins when the one before it has ended."""
        return (), ()

    def own_slot_us(self, node: int, cycle: int) -> tuple[float, float]:
        """Return the place of a node's longest share if all owners of turns send theirs."""
        owners = self.schedule.static_senders(cycle)
        sizes = [sum(self._longest) * (one in owners) for one in range(self.schedule.nodes)]
        sent = [frame for frame in self.transmissions(cycle, sizes) if frame.node == node]
        return sent[0].start_us, sent[-1].end_us

    def load(self, transmissions: Sequence[Transmission]) -> float:
        """Return the fraction of a cycle in which the bus carries frames."""
        return sum(frame.end_us - frame.start_us for frame in transmissions) / self.cycle_us

    def fusion_delay_us(self, rounds: int, last_cycle: Sequence[Transmission]) -> float:
        """Return the time from a measurement to the end of the last share."""
        end_us = max((frame.end_us for frame in last_cycle), default=0.0)
        return (rounds - 1) * self.cycle_us + end_us

    def check_pace(self, rounds: int, time_step_s: float, stretch: float) -> None:
        """Refuse cycles that do not fit the sampling time.

        Raises:
            ValueError: naming the times and the cure.
        """
        need_ms, step_ms = rounds * self.cycle_us / 1e3, stretch * time_step_s * 1e3
        # Products of decimals differ in the last bits.
        if need_ms <= step_ms * (1 + 1e-9):
            return
        fitting = int(step_ms * 1e3 / self.cycle_us)
        fewer = f"--rounds {fitting}, " if fitting else ""
        raise ValueError(
            f"{rounds} rounds are {rounds} cycles of {self.cycle_us / 1e3:.4g} ms = {need_ms:.4g} "
            f"ms on bus {self.name}, but the plant is sampled every {step_ms:.4g} ms; use {fewer}"
            f"--stretch {stretch * need_ms / step_ms:.4g}, or a lower --occupancy"
        )

    def split_payload(self, payload_bytes: int) -> tuple[int, ...]:
        """Return the payload of each frame of a share from the bytes of all its frames."""
        if not payload_bytes:
            return ()
        limit = self._longest[0] if len(self._longest) > 1 else payload_bytes
        full, last = divmod(payload_bytes, limit)
        return (limit,) * full + ((last,) if last else ())
