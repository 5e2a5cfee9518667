"""The interface of a bus: which node sends when, in which bytes, and how long that takes.

Nodes, environment, drivers and reports know a bus by this face alone.
`concord.bus.flexray.flexray_bus` and `concord.bus.ideal` implement it; features bring others.
"""

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, Self, TypeGuard, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from concord.bus.arbitration import ArbiterState
from concord.bus.schedule import Schedule
from concord.bus.timebase import Pace, Timebase


class Captured(NamedTuple):
    """Bytes on the bus (a whole frame, right or wrong) and when they began.

    In a collision other bits were on the wire.
    """

    time_us: float
    data: bytes
    channel: str = "A"
    collision: bool = False


class Link(NamedTuple):
    """How capture files keep the frames of a bus.

    Attributes:
        number: link type in the file header (https://www.tcpdump.org/linktypes.html).
        body: the packet that stands for a frame.
    """

    number: int
    body: Callable[[Captured], bytes]


_MAGIC_NANOSECONDS = 0xA1B23C4D
_FILE_HEADER = struct.Struct("<IHHiIII")
_PACKET_HEADER = struct.Struct("<IIII")
_MAX_PACKET_BYTES = 65535


def file_header(link_type: int) -> bytes:
    """Return the beginning of a capture file; packets are appended to it."""
    return _FILE_HEADER.pack(_MAGIC_NANOSECONDS, 2, 4, 0, 0, _MAX_PACKET_BYTES, link_type)


def timed(time_us: float, body: bytes) -> bytes:
    """Return a packet of a capture file. Times count from 0, as in a simulation."""
    seconds, nanoseconds = divmod(round(time_us * 1e3), 1_000_000_000)
    return _PACKET_HEADER.pack(seconds, nanoseconds, len(body), len(body)) + body


class Rejected(Exception):
    """A peer's frame or share that cannot be used; `reason` is a short word that is counted."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class TooLong(ValueError):
    """Shares of a length that a bus does not hold."""


class Fragment(msgspec.Struct, frozen=True):
    """Fragment of a share in one frame: in which slot, and in which of the cycles that carry
    rounds. `count` is the bus's own cycle counter in the frame; None on a bus without one. The
    frame has the checksum of `channel`; one on several channels travels with that of the first."""

    frame_id: int
    cycle: int
    data: bytes
    count: int | None = None
    channel: str = "A"


class SharePlace(msgspec.Struct, frozen=True):
    """A frame is number `number` of the `frames` of a share. Without `channels`, one letter each,
    it is on all channels of the bus."""

    number: int
    frames: int
    channels: str = ""


class Transmission(NamedTuple):
    """A frame on the bus, from its first bit to its last, from the beginning of the cycle.

    `segment` is "static" for a slot of its own and "dynamic" for one that was awarded, which begins
    with minislot `minislot`; `minislot` is 0 for a slot of its own.
    """

    node: int
    frame_id: int
    channel: str
    segment: str
    payload_bytes: int
    start_us: float
    end_us: float
    minislot: int = 0


class SegmentTime(NamedTuple):
    """A segment of the communication cycle and its place in it."""

    name: str
    start_us: float
    end_us: float


class FrameFormat(NamedTuple):
    """How the frames of a bus carry shares; the same for every schedule and in a whole run.

    Attributes:
        name: of the encoding, as a recording states it.
        payload_limit_bytes: longest payload of a frame.
        overhead_bytes: of a frame beside its payload.
        numbering_bytes: of a payload beside its part of a share.
        noticed_bits: a receiver finds any this many wrong bits in a frame.
        read: the fragment in a frame; raises `Rejected` for bytes that are no sound frame.
        cycle_of: the cycle that a frame names, unchecked; 0 for bytes that are too few.
        numbered: the place of a fragment (its `data`) in its share; raises `Rejected` for one that
            is too short to say.
        join: the body of a share whose fragments (their `data`) have all come, in any order; raises
            `Rejected` where they do not belong together.
        emptied: the frame with nothing in it, as a controller sends it that its host left alone.
        miscounted: the frame whose header is so many cycles ahead of its payload.
        on_channel: a frame of a share as it is on the channel of that name.
        link: how capture files keep the frames; None for frames that no capture file has.
    """

    name: str
    payload_limit_bytes: int
    overhead_bytes: int
    numbering_bytes: int
    noticed_bits: int
    read: Callable[[bytes], Fragment]
    cycle_of: Callable[[bytes], int]
    numbered: Callable[[bytes], SharePlace]
    join: Callable[[Sequence[bytes]], bytes]
    emptied: Callable[[bytes], bytes]
    miscounted: Callable[[bytes, int], bytes]
    on_channel: Callable[[bytes, str], bytes]
    link: Link | None = None


class Awards(NamedTuple):
    """Result of a contest: the arbiter's state, the winners (..., C) of the contenders, and the
    urgency class (..., C) in which each asked; 0 where a node has one frame ID. `cut` (..., C): so
    many frames of a share are sent that does not fit whole; None where no host lets that happen."""

    state: ArbiterState
    wins: NDArray[np.bool_]
    classes: NDArray[np.int64]
    cut: NDArray[np.int64] | None = None

    def cut_shares(self, nodes: Sequence[int]) -> list[tuple[int, int, int]]:
        """Return node, frames and class of each share that is cut, of these contenders (C,)."""
        if self.cut is None:
            return []
        frames, classes = self.cut.tolist(), self.classes.tolist()
        return [one for one in zip(nodes, frames, classes, strict=True) if one[1]]


class Bus(Protocol):
    """A bus that follows a schedule, made for shares of a known greatest length."""

    @property
    def name(self) -> str:
        """Return the name for people."""
        ...

    @property
    def schedule(self) -> Schedule:
        """Return which nodes may send in which cycle."""
        ...

    @property
    def frame_format(self) -> FrameFormat:
        """How its frames carry shares."""
        ...

    # --- shares and frames ------------------------------------------------------------------------

    def encode(self, node: int, cycle: int, body: bytes, urgency_class: int = 0) -> list[bytes]:
        """Return the frames in which a node sends a share in a cycle, in the slots of its class.

        A class beyond those that the node has counts as its last.

        Raises:
            ValueError: the share is longer than the node's slots.
        """
        ...

    def payloads(self, node: int, cycle: int, body_bytes: int) -> tuple[int, ...]:
        """Return the payload length of each frame that `encode` makes of a body of that length."""
        ...

    def due_body(self, frame: bytes, sender: int, cycle: int, body_bytes: int) -> bytes | None:
        """Return the body in a frame that is bit by bit what `encode` makes of one of that length;
        None for every other frame."""
        ...

    def receive(self, frame: bytes) -> Fragment:
        """Return what a frame carries.

        Raises:
            Rejected: with the reason of the check that failed.
        """
        ...

    def place(self, sender: int, fragment: Fragment) -> SharePlace:
        """Return where a fragment of this sender belongs in its share.

        Raises:
            Rejected: nowhere, or its cycle counter is not that of its cycle.
        """
        ...

    def urgency_class(self, node: int, cycle: int, frame_id: int) -> int:
        """Return the class of a node's frame ID; 0 for an ID that is not the node's."""
        ...

    def in_slot_of(self, frame: bytes, node: int, cycle: int) -> bytes | None:
        """Return a sound frame moved to the first slot of a node; None where it has no slot."""
        ...

    def renumbered(self, frame: bytes, cycle: int) -> bytes:
        """Return a sound frame with the number of another cycle."""
        ...

    # --- awarded slots ----------------------------------------------------------------------------

    @property
    def has_ideal_arbiter(self) -> bool:
        """Whether slots are awarded in an order that no controller knows."""
        ...

    def arbitrate(
        self,
        state: ArbiterState,
        cycle: int,
        group: int,
        nodes: Sequence[int] | NDArray[np.int64],
        bids: NDArray[np.int64],
        payload_bytes: Callable[[], NDArray[np.int64]],
    ) -> Awards:
        """Award the slots of one group of a cycle.

        Args:
            state: what the arbiter remembers; `begin_arbitration` makes the first.
            cycle: the communication cycle.
            group: number of the group in the cycle.
            nodes: (C,), the contenders, ascending.
            bids: (..., C), `NO_BID` of a contender that does not ask.
            payload_bytes: (..., C), of all frames of a contender's share; called where not all
                shares fit.
        """
        ...

    # --- time -------------------------------------------------------------------------------------

    @property
    def timebase(self) -> Timebase:
        """Return which cycles of the bus carry the rounds of the run; `cycle` counts those."""
        ...

    def paced(self, pace: Pace) -> Self:
        """Return the bus in a run of this pace."""
        ...

    @property
    def has_time(self) -> bool:
        """Whether the bus says how long a cycle lasts. The times of one that does not are counted
        in shares, for drawing alone."""
        ...

    @property
    def cycle_us(self) -> float:
        """Duration of a communication cycle; 0 without time."""
        ...

    @property
    def channels(self) -> str:
        """Return the names of its channels, one letter each; `SharePlace` says which carry it."""
        ...

    @property
    def clock_precision_us(self) -> float:
        """How far two clocks may be apart before a frame leaves its slot; 0 without time."""
        ...

    @property
    def worst_access_us(self) -> float:
        """The longest time from the request of a share, at any moment, to its last bit; NaN for a
        bus that states none."""
        ...

    def segments(self) -> tuple[SegmentTime, ...]:
        """Return the segments of a cycle, in order; they meet."""
        ...

    def marks_us(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return where slots end that nodes own, and where minislots begin."""
        ...

    def own_slot_us(self, node: int, cycle: int) -> tuple[float, float]:
        """Return the beginning and the end of the slots that a node owns in a cycle."""
        ...

    def transmissions(
        self, cycle: int, payload_bytes: Sequence[int], classes: Sequence[int] = ()
    ) -> tuple[Transmission, ...]:
        """Return the frames of a cycle from the payload bytes of each node, 0 of a silent one.

        The bytes are those of all frames of a node together: the owner of a slot sends in as many
        of its slots as it takes, any other node in awarded slots. Those have the frame IDs of the
        node's urgency class; empty `classes` are all 0.
        """
        ...

    def load(self, transmissions: Sequence[Transmission]) -> float:
        """Return the fraction of a cycle that the busier channel is in use; NaN without time."""
        ...

    def fusion_delay_us(self, rounds: int, last_cycle: Sequence[Transmission]) -> float:
        """Return the time from the first cycle of a step to the end of its last share; NaN without
        time. The step may wait for its first cycle (`Timebase.wait_us`)."""
        ...

    def check_pace(self, rounds: int, time_step_s: float, stretch: float) -> None:
        """Refuse communication cycles that do not fit the plant's sampling time.

        Raises:
            ValueError: they do not; names the cure.
        """
        ...


@runtime_checkable
class Retransmits(Protocol):
    """A bus whose controllers send a frame again when any receiver reports an error.

    `retransmissions` is how often at most. A cycle has time for all of them.
    """

    @property
    def retransmissions(self) -> int:
        """Return how often a frame is sent again at most."""
        ...

    def failed_us(self, payload_bytes: int) -> float:
        """Return the time of a frame that ends in an error, until the next one may begin."""
        ...

    def delays_us(self, cycle: Sequence[Transmission], failed: Sequence[int]) -> tuple[float, ...]:
        """Return how much later the first try of each frame of a cycle begins because of errors,
        where so many tries of each fail."""
        ...


def retransmits(bus: object) -> TypeGuard[Retransmits]:
    """Return whether a bus sends frames again after errors."""
    return isinstance(bus, Retransmits) and bus.retransmissions > 0
