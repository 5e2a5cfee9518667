"""The closed vocabulary of the network: the messages of environment and nodes, and their bytes.

A share is not in this list of encodings: it travels as the bytes of the bus's frames
(`bus/bus.py`). Everything else is JSON, which anyone can read in a recording and which carries
a float64 without loss (shortest representation that reads back to the same bits); a missing value
is `null`.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from concord.nodes.bounds import (
    MAX_MESSAGE_BYTES,
    MAX_ROUNDS,
    UNREADABLE,
    Group,
    Instant,
    NodeIndex,
    NodeList,
    NodeTuple,
    UrgencyClass,
    node_of,
)
from concord.nodes.changes import Change, Event, Gone, Set, Welcome

# Recorder to all: all messages are kept, and every process may leave.
END = b"{}"
TRACK_NUMBERS = 12
"""Numbers of a reported track."""


class Measured(msgspec.Struct, frozen=True):
    """Environment to node: the heartbeat that opens a step, with the node's readings.

    `readings` has shape (readings, d); `control` (p,) is what drove the plant into this step;
    `changes` hold from this step on.
    """

    node: NodeIndex
    step: Instant
    readings: list[list[float | None]]
    control: list[float] | None = None
    changes: tuple[Change, ...] = ()


class ShareSent(msgspec.Struct, frozen=True):
    """Node to its neighbours: one frame on the bus in communication cycle `cycle`."""

    node: NodeIndex
    cycle: Instant
    frame: bytes


class Bid(msgspec.Struct, frozen=True):
    """Contender to environment: its urgency for a dynamic slot; None asks for no slot.

    `payload_bytes` is the length of all its payloads together, 0 where it asks for no slot. `group`
    is the group of the cycle (`concord.bus.schedule.Schedule.groups`).
    """

    node: NodeIndex
    cycle: Instant
    bid: int | None
    payload_bytes: Instant
    group: Group = 0


class CutShare(msgspec.Struct, frozen=True, omit_defaults=True):
    """A node sends so many frames of a share that does not fit whole, in frame IDs of a class."""

    node: NodeIndex
    frames: Instant
    urgency_class: UrgencyClass = 0


CutShares = Annotated[list[CutShare], Meta(max_length=1 << 16)]


class Grant(msgspec.Struct, frozen=True):
    """Environment to all: the winners of this group's dynamic slots, ascending.

    `classes` are those in whose frame IDs the winners send; left out where nodes have one frame ID.
    In real time `unheard` are contenders that had not asked when bids ended. `cut` are shares of
    which only the first frames are sent.
    """

    cycle: Instant
    winners: NodeList
    group: Group = 0
    unheard: NodeList | msgspec.UnsetType = msgspec.UNSET
    classes: NodeList | msgspec.UnsetType = msgspec.UNSET
    cut: CutShares | msgspec.UnsetType = msgspec.UNSET

    def urgency_class(self, node: int) -> int:
        """The class in whose frame ID a winner sends; 0 where the grant says nothing of it."""
        if self.classes is msgspec.UNSET:
            return 0
        return dict(zip(self.winners, self.classes, strict=False)).get(node, 0)

    @property
    def cut_shares(self) -> dict[int, CutShare]:
        """The shares that are cut, by their senders."""
        return {} if self.cut is msgspec.UNSET else {one.node: one for one in self.cut}


class Truth(msgspec.Struct, frozen=True):
    """Environment to recorder: the plant's state (n,) at a step, null where it is unknown."""

    step: Instant
    state: list[float | None]


class ReportedTracks(msgspec.Struct, frozen=True):
    """The tracks of a node that stand for targets, each a row of twelve numbers.

    A row has identity (3), existence, mean (4) and standard deviations (4). `records` is a digest
    of all records that the node has used, "" under rules without, and `bits` one of all numbers of
    all its tracks.
    """

    rows: list[Annotated[list[float], Meta(min_length=TRACK_NUMBERS, max_length=TRACK_NUMBERS)]]
    records: str
    bits: str


class Estimate(msgspec.Struct, frozen=True, omit_defaults=True):
    """Node to environment: its belief after the last round of a step, and the shares it used.

    `mean` (n,), `cov` the upper triangle row by row; `ages` per neighbour in communication cycles
    (-1: never heard); `counters` are totals since the start. `generators` (n, q) are those of a
    node that keeps a zonotope with the centre `mean`; then `cov` describes an ellipsoid around it.
    `smoothed` and `smoothed_std` (L, n) are means and standard deviations of the states of 0, 1,
    ... steps ago, of a node that estimates them. `suspect`: what the node has heard does not fit
    its belief. `age_s`: in real time, seconds since the sampling instant of the step. `absent`:
    the nodes that it takes for out. `weights` are those of the neighbours' shares in the last
    round, rounded to four decimals, of a rule that averages; the rest is the weight of the own
    share. `tracks` are those of a node that follows several targets. `gap`: the trace of a set that
    a programme found is within this fraction of the least.
    """

    node: NodeIndex
    step: Instant
    mean: list[float | None]
    cov: list[float | None]
    ages: list[int]
    counters: dict[str, int]
    generators: list[list[float]] | None = None
    smoothed: list[list[float | None]] | None = None
    smoothed_std: list[list[float | None]] | None = None
    suspect: bool = False
    age_s: float | None = None
    absent: NodeTuple = ()
    weights: list[float | None] | None = None
    tracks: ReportedTracks | None = None
    gap: float | None = None


class Start(msgspec.Struct, frozen=True):
    """Environment to nodes, in real time: start of step 0 on this machine's monotonic clock."""

    at_s: float


class Timing(msgspec.Struct, frozen=True):
    """Node to recorder, in real time: how well a step kept its time.

    `heartbeat_late_s` (None: the node stopped waiting for it) and `cycle_late_s` (rounds,) are
    delays against the timetable. `incomplete` cycles ended at their deadline without a frame that
    was due; `overrun` cycles began after their own deadline.
    """

    node: NodeIndex
    step: Instant
    heartbeat_late_s: float | None
    cycle_late_s: list[float]
    incomplete: Instant
    overrun: Instant


class Unreachable(msgspec.Struct, frozen=True):
    """Node to environment: the link to a neighbour is broken; both may still be reachable."""

    node: NodeIndex
    neighbour: NodeIndex


class CycleClosed(msgspec.Struct, frozen=True):
    """Driver to node: the time of this group is over; go on with the shares received."""

    cycle: int
    group: int = 0


class BidsClosed(msgspec.Struct, frozen=True):
    """Driver to environment, in real time: later requests for this group are late."""

    cycle: int
    group: int


class StepClosed(msgspec.Struct, frozen=True):
    """Driver to environment, in real time: later estimates of this step are ignored."""

    step: int


class Allowed(msgspec.Struct, frozen=True):
    """Run controller to environment: steps before `limit` may begin."""

    limit: int


class ShareHeard(msgspec.Struct, frozen=True):
    """Driver to node: a frame arrived on the channel of `sender`."""

    sender: int
    frame: bytes


NodeEvent = Measured | ShareHeard | Grant | CycleClosed | Gone
NodeMessage = ShareSent | Bid | Estimate
EnvironmentEvent = Bid | Estimate | Gone | BidsClosed | StepClosed | Allowed
EnvironmentMessage = Measured | Grant | Truth | Event | Gone | Welcome
Message = NodeMessage | EnvironmentMessage | Start | Timing | Unreachable

_TYPES: dict[str, type] = {
    "measured": Measured,
    "bid": Bid,
    "grant": Grant,
    "truth": Truth,
    "estimate": Estimate,
    "event": Event,
    "gone": Gone,
    "welcome": Welcome,
    "start": Start,
    "timing": Timing,
    "unreachable": Unreachable,
}
_KINDS: dict[type, str] = {ShareSent: "share", **{type_: kind for kind, type_ in _TYPES.items()}}
# One node's topics, by name; what they carry must be of that node.
_OWNED = ("measured", "bid", "estimate", "timing", "unreachable")
# Messages to all processes, about one node or about none, share one topic each.
_SHARED = ("grant", "truth", "event", "gone", "start")
# Messages that go both to all processes and to a single node.
_BOTH = ("gone",)
_encoder = msgspec.json.Encoder()
_decoders = {topic: msgspec.json.Decoder(type_) for topic, type_ in _TYPES.items()}


def message_types() -> dict[str, type]:
    """The first part of each topic that carries JSON, and the type of its messages."""
    return dict(_TYPES)


def is_topic(name: str, nodes: int) -> bool:
    """Whether any message of a network of so many nodes travels on a topic of this name."""
    kind, slash, owner = name.partition("/")
    if not slash:
        return kind in _SHARED
    is_owned = kind in _KINDS.values() and (kind not in _SHARED or kind in _BOTH)
    return is_owned and node_of(owner, nodes) is not None


class MalformedMessage(ValueError):
    """Bytes on a topic that are not a message of that topic."""


def topic(message: Message) -> str:
    """Where a message travels: `share/3`, `grant`, ... (the key below `concord/<run>/`)."""
    kind = _KINDS[type(message)]
    return kind if kind in _SHARED else f"{kind}/{message.node}"  # type: ignore[union-attr]


def encode(message: Message) -> bytes:
    """The bytes of a message as it travels."""
    return message.frame if isinstance(message, ShareSent) else _encoder.encode(message)


def decode(topic_name: str, data: bytes) -> Any:
    """The message that `data` on `topic_name` (not a share) means.

    Raises:
        MalformedMessage: unknown topic, bytes that do not fit it, or are beyond all bounds, or a
            node that speaks of another on its own topic.
    """
    kind, _, owner = topic_name.partition("/")
    decoder = _decoders.get(kind)
    if decoder is None:
        raise MalformedMessage(f"no message travels on topic {topic_name[:60]!r}")
    if len(data) > MAX_MESSAGE_BYTES:
        raise MalformedMessage(
            f"topic {topic_name[:60]!r} carried {len(data)} bytes, at most {MAX_MESSAGE_BYTES}"
        )
    try:
        message = decoder.decode(data)
    except UNREADABLE as error:
        what = f"topic {topic_name[:60]!r} carried {data[:60]!r}"
        raise MalformedMessage(f"{what}: {error}") from None
    if kind in _OWNED and str(message.node) != owner:
        raise MalformedMessage(f"topic {topic_name[:60]!r} carried what is of node {message.node}")
    if kind == "measured" and len({len(reading) for reading in message.readings}) > 1:
        raise MalformedMessage(f"topic {topic_name[:60]!r} carried readings of different lengths")
    for change in _changes(message):
        if isinstance(change, Set) and not _has_rounds(change):
            raise MalformedMessage(f"topic {topic_name[:60]!r} carried impossible rounds")
    return message


def _changes(message: Any) -> Sequence[Change]:
    match message:
        case Measured():
            return message.changes
        case Event():
            return (message.change,)
    return ()


def _has_rounds(change: Set) -> bool:
    """Whether every reader can count cycles from here on."""
    return change.settings.get("rounds", 1) in range(1, MAX_ROUNDS + 1)


def to_wire(values: np.ndarray) -> list[Any]:
    """Nested lists of floats with None for NaN, as JSON has no NaN."""
    if values.ndim > 1:
        return [to_wire(row) for row in values]
    return [None if math.isnan(value) else value for value in values.tolist()]


def from_wire(values: list[Any]) -> np.ndarray:
    """The array that `to_wire` wrote; None becomes NaN."""
    return np.array(values, dtype=np.float64)
