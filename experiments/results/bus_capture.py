"""Capture of a run's bus: its frames as they were on the wire, faults of senders and channels
included.

A recording holds the frame that a sender meant to send. The outcome on the wire follows from the
standing faults by the draws that the nodes made. Faults of single receivers leave the wire as it
is, and so do frames of a clock that has drifted out of its slot.
"""

from collections.abc import Iterable, Iterator, Sequence

from concord.bus.bus import Bus, FrameFormat, Rejected, Transmission
from concord.bus.flexray.frame import FrameError
from concord.bus.recordings.pcap import Captured
from concord.experiments.results.bus_report import SentShares, timetable
from concord.experiments.results.trace import Trace
from concord.nodes.changes import UNCHANGED, Event, after
from concord.nodes.faults.active import Faults
from concord.nodes.faults.links import Passage, carries, collides
from concord.nodes.faults.senders import sent
from concord.runtime.recorded import SharedFrame, meaning
from concord.scenarios.build import build_bus
from concord.scenarios.equipment import build_faults
from concord.scenarios.setup import Setup

# A receiver has no place on the wire.
_NOBODY = 0
_LAST_BIT = 1


def capture(
    setup: Setup, trace: Trace, messages: Iterable[tuple[str, bytes]]
) -> list[Captured] | None:
    """The frames of a recording in the order and at the time of the bus; None for one without time,
    or for one that was replaced by another in the run.

    Frames of steps that not every node completed are left out, and so are frames of shares of which
    the recording has lost a part. A cluster with two channels carries each frame on both.
    """
    bus = build_bus(setup)
    if not (bus.has_time and trace.history.one_bus):
        return None
    rounds, frames = setup.scenario.rounds, bus.frame_format
    placed = [
        {(frame.node, frame.frame_id): frame for frame in cycle}
        for cycle in timetable(bus, SentShares(trace.payload_bytes, trace.classes))
    ]
    shares: list[tuple[SharedFrame, bytes]] = []
    events: list[Event] = []
    for topic, data in messages:
        match meaning(topic, data, setup.scenario.nodes, frames):
            case SharedFrame() as share if share.fragment.cycle < len(placed):
                shares.append((share, data))
            case Event() as event:
                events.append(event)
    faults = _faults(build_faults(setup, bus), events, len(trace.payload_bytes))
    captured: list[Captured] = []
    for share, data in shares:
        cycle = share.fragment.cycle
        frame = placed[cycle].get((share.node, share.fragment.frame_id))
        if frame is None:
            continue
        step = cycle // rounds
        time_us = bus.timebase.begins_us(cycle) + frame.start_us
        captured += _on_the_wire(bus, faults[step], step, share, frame, data, time_us)
    return sorted(captured, key=lambda one: (one.time_us, one.channel))


def _faults(none: Faults, events: Sequence[Event], steps: int) -> list[Faults]:
    """The faults that stand in each step."""
    standing, found = UNCHANGED, []
    for step in range(steps):
        for event in events:
            if event.step == step:
                standing = after(standing, step, event.change)
        found.append(none.stand(standing))
    return found


def _on_the_wire(
    bus: Bus,
    faults: Faults,
    step: int,
    share: SharedFrame,
    frame: Transmission,
    data: bytes,
    time_us: float,
) -> Iterator[Captured]:
    """Yield a frame on each channel that carries it."""
    if not faults.standing:
        for channel in frame.channel:
            yield Captured(time_us, bus.frame_format.on_channel(data, channel), channel)
        return
    fragment = share.fragment
    try:
        number = bus.place(share.node, fragment).number
    except Rejected:
        number = 0
    way = Passage(step, fragment.cycle, share.node, _NOBODY, number, fragment.frame_id)
    whole = sent(faults, step, fragment.cycle, share.node, number, data, bus)
    collision = collides(faults, way)
    for channel in frame.channel:
        if carries(faults, way, faults.equipment.channels.index(channel)):
            body = _on_channel(bus.frame_format, whole, channel)
            yield Captured(time_us, body, channel, collision)


def _on_channel(frames: FrameFormat, data: bytes, channel: str) -> bytes:
    """A frame with the checksum of its channel, wrong if it was wrong."""
    try:
        return frames.on_channel(data, channel)
    except FrameError:
        # A broken controller turns the last bit over.
        right = data[:-1] + bytes([data[-1] ^ _LAST_BIT])
        turned = frames.on_channel(right, channel)
        return turned[:-1] + bytes([turned[-1] ^ _LAST_BIT])
