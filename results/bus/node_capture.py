"""Capture of one node of a run: the frames of its neighbours as they arrived at it, and its own.

Faults of links strike single receivers: a frame that the link has lost, or that came in another
cycle, leaves a gap; a corrupted frame has its wrong bits on each channel. The outcome follows from
the recording by the draws that the node made.
"""

from collections.abc import Iterator

from concord.bus.bus import Captured
from concord.nodes.faults.links import arrival, carries
from concord.nodes.faults.losses import LinkState, hears
from concord.nodes.faults.retries import without_errors
from concord.nodes.faults.senders import sent
from concord.nodes.node_changes import with_standing
from concord.results.bus.bus_capture import (
    FrameOnBus,
    Traffic,
    error_frames,
    in_order,
    on_channel,
    on_the_wire,
)
from concord.scenarios.links import link_state
from concord.scenarios.setup import Setup


def node_capture(setup: Setup, traffic: Traffic, node: int) -> list[Captured]:
    """Return the frames that came to a node, and those that it sent, in the order of the bus."""
    links, captured = link_state(setup), list[Captured]()
    for frame in traffic.frames:
        if frame.way.sender == node:
            captured += on_the_wire(traffic, frame)
        elif frame.way.sender in setup.neighbours[node]:
            captured += _arrived(traffic, links, frame, node)
    return in_order(captured)


def _arrived(
    traffic: Traffic, links: LinkState, frame: FrameOnBus, node: int
) -> Iterator[Captured]:
    """Yield a frame on each channel that brought it to a receiver."""
    way, standing = frame.way._replace(receiver=node), traffic.standing[frame.way.step]
    here = with_standing(links, standing)
    if node in standing.absent or not hears(
        here, way.step, way.cycle, way.sender, node, way.number
    ):
        return
    faults = traffic.faults(way.step)
    yield from error_frames(frame)
    came = arrival(faults, way, frame.data, traffic.bus)
    collision = came.counted == ("rejected collision",)
    if not (came.in_slot or collision):
        return
    if frame.failed:
        faults = without_errors(faults)
    whole = sent(faults, way.step, way.cycle, way.sender, way.number, frame.data, traffic.bus)
    # A collision has destroyed the frame, so no bits of it arrived.
    read = came.frame if came.in_slot else whole
    for channel in frame.place.channel:
        if carries(faults, way, channel):
            right = on_channel(traffic.bus.frame_format, whole, channel)
            flipped = zip(right, whole, read, strict=True)
            data = bytes(byte ^ before ^ after for byte, before, after in flipped)
            yield Captured(frame.last_us, data, channel, collision)
