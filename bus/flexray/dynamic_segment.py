"""The dynamic segment of one cycle: which of the requested frames are sent, in which minislots.

FlexRay protocol specification 2.1, chapter 5: a slot counter goes on from the static segment. While
no node sends in a slot, it lasts one minislot; a frame makes it as long as the frame needs. A node
begins no frame after minislot pLatestTx, so frames with high IDs wait when low IDs were busy.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import pairwise, takewhile
from typing import NamedTuple

import msgspec

from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.cluster_parameters import Channels
from concord.bus.flexray.frame import MAX_FRAME_ID


class MessageSlot(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame that a node sends: its ID, its cycles, its payload, and how often it is requested.

    It may be sent in the cycles with `cycle % repetition == base_cycle`. Requests come `period_us`
    apart at least; without it, once in each of its cycles. With `offset_us` they come at that time
    of the bus and exactly every `period_us` after it. `deadline_us` bounds the time from a request
    to the end of the frame; without it, nothing does. A node with dynamic frames of several urgency
    classes sends those of one class in a cycle. `latest_transmission_minislot` is the pLatestTx of
    its controller, if not the cluster's.
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
    latest_transmission_minislot: int | None = None

    def sends(self, cycle: int) -> bool:
        """Whether the frame may be sent in a cycle."""
        return cycle % self.repetition == self.base_cycle


class Request(NamedTuple):
    """A node's wish to send: `frame_id` is its place in the segment.

    More payload than one frame holds is sent as several frames, in slots `frame_id` and following.
    `latest` is the pLatestTx of the node's controller; None for the cluster's.
    """

    node: int
    frame_id: int
    payload_bytes: int
    latest: int | None = None


class PlacedFrame(NamedTuple):
    """One frame in the segment: its slot begins at `minislot` (1 is the first)."""

    node: int
    frame_id: int
    payload_bytes: int
    minislot: int
    minislots: int


class Walk(NamedTuple):
    """Frames in order of time, and the requests that are not sent whole in this cycle."""

    placed: tuple[PlacedFrame, ...]
    waiting: tuple[Request, ...]


def walk(cluster: Cluster, requests: Iterable[Request], frame_by_frame: bool = False) -> Walk:
    """Count through the dynamic slots of one cycle in which these requests are pending.

    A request is sent completely or not at all. With `frame_by_frame` its first frames are sent even
    where the others find no room.

    Raises:
        ValueError: two requests share a slot, or a frame ID belongs to no dynamic slot.
    """
    ordered = sorted(requests, key=lambda request: request.frame_id)
    _check_slots(cluster, ordered)
    placed: list[PlacedFrame] = []
    waiting: list[Request] = []
    minislot, slot = 1, cluster.first_dynamic_id
    for request in ordered:
        minislot += request.frame_id - slot
        frames = _frames(cluster, request, minislot)
        slot = request.frame_id + len(frames)
        sent = list(takewhile(partial(_in_time, cluster, request.latest), frames))
        if len(sent) < len(frames):
            waiting.append(request)
            sent = sent if frame_by_frame else []
        if sent:
            placed += sent
            minislot = sent[-1].minislot + sent[-1].minislots
        minislot += len(frames) - len(sent)
    return Walk(tuple(placed), tuple(waiting))


def frame_payloads(cluster: Cluster, payload_bytes: int) -> tuple[int, ...]:
    """Payload lengths of the frames in which a request's payload is sent; all but the last full."""
    limit = cluster.dynamic_payload_bytes
    if payload_bytes <= limit:
        return (payload_bytes,)
    if limit == 0:
        raise ValueError(f"cluster {cluster.name!r} has no payload in dynamic frames; set more")
    full, rest = divmod(payload_bytes, limit)
    return (limit,) * full + ((rest,) if rest else ())


def _frames(cluster: Cluster, request: Request, minislot: int) -> list[PlacedFrame]:
    """The frames of a request in consecutive slots from this minislot on."""
    frames: list[PlacedFrame] = []
    for index, payload_bytes in enumerate(frame_payloads(cluster, request.payload_bytes)):
        minislots = cluster.dynamic_slot_minislots(payload_bytes)
        frame_id = request.frame_id + index
        frames.append(PlacedFrame(request.node, frame_id, payload_bytes, minislot, minislots))
        minislot += minislots
    return frames


def _in_time(cluster: Cluster, latest: int | None, frame: PlacedFrame) -> bool:
    """Begins by pLatestTx and ends in the segment."""
    return (
        frame.minislot <= (cluster.latest_transmission_minislot if latest is None else latest)
        and frame.minislot + frame.minislots - 1 <= cluster.minislots
    )


def _check_slots(cluster: Cluster, ordered: Sequence[Request]) -> None:
    if ordered and ordered[0].frame_id < cluster.first_dynamic_id:
        raise ValueError(
            f"node {ordered[0].node} asks for the dynamic segment with frame ID "
            f"{ordered[0].frame_id}, but the dynamic slots of cluster {cluster.name!r} begin at "
            f"{cluster.first_dynamic_id}; give it an ID from there on"
        )
    if ordered and ordered[-1].frame_id > MAX_FRAME_ID:
        raise ValueError(
            f"node {ordered[-1].node} asks for the dynamic segment with frame ID "
            f"{ordered[-1].frame_id}, but IDs end at {MAX_FRAME_ID}; use fewer contenders"
        )
    for earlier, later in pairwise(ordered):
        last = earlier.frame_id + len(frame_payloads(cluster, earlier.payload_bytes)) - 1
        if later.frame_id <= last:
            raise ValueError(
                f"nodes {earlier.node} and {later.node} both send in dynamic slot "
                f"{later.frame_id}; give them frame IDs of their own"
            )


def requests_of(slots: Sequence[MessageSlot], cluster: Cluster) -> list[Request]:
    """Return the requests of other stations in the dynamic segment, all in one cycle.

    Of stations that take turns in one frame ID the longest frame counts.
    """
    longest: dict[int, MessageSlot] = {}
    for slot in slots:
        if slot.frame_id >= cluster.first_dynamic_id:
            known = longest.setdefault(slot.frame_id, slot)
            if slot.payload_bytes > known.payload_bytes:
                longest[slot.frame_id] = slot
    return [
        Request(slot.node, slot.frame_id, slot.payload_bytes, slot.latest_transmission_minislot)
        for slot in longest.values()
    ]
