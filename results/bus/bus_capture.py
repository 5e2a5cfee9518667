"""Capture of a run's bus: its frames as they were on the wire, faults of senders and channels
included.

A recording holds the frame that a sender meant to send. The outcome on the wire follows from the
standing faults by the draws that the nodes made. Faults of single receivers leave the wire as it
is.

Static slots that their owner leaves unused carry null frames. They are not in the recording, and
follow from the slot table; faults strike frames of shares alone.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import groupby
from math import ceil
from typing import NamedTuple

import msgspec

from concord.bus.bus import (
    Bus,
    Captured,
    FrameFormat,
    Rejected,
    Retransmits,
    Transmission,
    retransmits,
)
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.frame import FrameError
from concord.nodes.changes import UNCHANGED, Event, Standing, after
from concord.nodes.faults.active import Faults, sends_nothing
from concord.nodes.faults.links import carries
from concord.nodes.faults.retries import (
    Passage,
    collides,
    failed_tries,
    is_given_up,
    without_errors,
)
from concord.nodes.faults.senders import sent
from concord.results.bus.bus_times import timetable
from concord.results.records.trace import Trace
from concord.runtime.recorded import SharedFrame, meaning
from concord.scenarios.build import build_bus
from concord.scenarios.equipment import build_faults
from concord.scenarios.setup import Setup

# A receiver has no place on the wire.
_NOBODY = 0
_LAST_BIT = 1
# Frames of a capture: about 200 MB.
MOST_FRAMES = 2_000_000


class FrameOnBus(NamedTuple):
    """A frame of a share as its sender meant it.

    `way` is that to one receiver, `frames` how many its share has, `place` its place in the cycle,
    and `time_us` its beginning from that of the run. On a bus with automatic retransmission that is
    the beginning of the first try; `failed` tries of `failed_us` each end in an error.
    """

    data: bytes
    way: Passage
    frames: int
    place: Transmission
    time_us: float
    failed: int = 0
    failed_us: float = 0.0

    @property
    def last_us(self) -> float:
        """When the try begins that has no error."""
        return self.time_us + self.failed * self.failed_us


class Traffic(NamedTuple):
    """Frames of all shares of a run on a bus with time, and the standing changes of each step."""

    bus: Bus
    none: Faults
    frames: list[FrameOnBus]
    standing: list[Standing]

    def faults(self, step: int) -> Faults:
        """Return the faults that stand in a step."""
        return self.none.stand(self.standing[step])


def capture(
    setup: Setup, trace: Trace, messages: Iterable[tuple[str, bytes]], all_cycles: bool = False
) -> list[Captured] | None:
    """The frames of a recording in the order and at the time of the bus.

    None for a bus without time, for one whose frames no capture file has, or for one that was
    replaced by another in the run.

    Frames of steps that not every node completed are left out, and so are frames of shares of which
    the recording has lost a part. A cluster with two channels carries each frame on both.
    `all_cycles` adds the cycles between the steps, in which static slots carry null frames.
    """
    traffic = traffic_of(setup, trace, messages)
    if traffic is None:
        return None
    captured = list(_unused_slots(traffic))
    if all_cycles:
        captured += _between_steps(traffic, len(trace.payload_bytes), setup.scenario.rounds)
    for frame in traffic.frames:
        captured += on_the_wire(traffic, frame)
    return in_order(captured)


def in_order(captured: Iterable[Captured]) -> list[Captured]:
    """Return captured frames in order of time, channel A first."""
    return sorted(captured, key=lambda one: (one.time_us, one.channel))


def check_all_cycles(setup: Setup) -> None:
    """Refuse a capture of all cycles that would be too large.

    Raises:
        ValueError: naming the number of frames, the limit and the cure.
    """
    bus, steps = build_bus(setup), setup.scenario.steps
    if not isinstance(bus, FlexRayBus):
        raise ValueError(
            f"--capture all: the bus {bus.name!r} has no null frames; leave it out, or use "
            "--bus flexray"
        )
    slots = [len(list(bus.null_frames(turn, turn))) for turn in range(bus.schedule.period)]
    frames = len(bus.channels) * bus.timebase.cycles_of(steps) * sum(slots) / len(slots)
    if frames > MOST_FRAMES:
        raise ValueError(
            f"--capture all: {frames:.0f} null frames in {bus.timebase.cycles_of(steps):.0f} "
            f"cycles, and a capture has at most {MOST_FRAMES}; use --capture used, or at most "
            f"--steps {int(steps * MOST_FRAMES / frames)}"
        )


def traffic_of(setup: Setup, trace: Trace, messages: Iterable[tuple[str, bytes]]) -> Traffic | None:
    """The frames of all whole shares of a recording; None where `capture` is None."""
    bus = build_bus(setup)
    if not (bus.has_time and trace.history.one_bus) or bus.frame_format.link is None:
        return None
    placed = [
        {(frame.node, frame.frame_id): frame for frame in cycle}
        for cycle in timetable(bus, trace.sent)
    ]
    frames: list[FrameOnBus] = []
    events: list[Event] = []
    for topic, data in messages:
        if topic.partition("/")[0] not in ("share", "event"):
            continue
        match meaning(topic, data, setup.scenario.nodes, bus.frame_format):
            case SharedFrame(node, fragment) if fragment.cycle < len(placed):
                # A frame that came twice is one.
                place = placed[fragment.cycle].pop((node, fragment.frame_id), None)
                if place is None:
                    continue
                step = fragment.cycle // setup.scenario.rounds
                try:
                    number, count, _ = msgspec.structs.astuple(bus.place(node, fragment))
                except Rejected:
                    number, count = 0, 0
                way = Passage(
                    step, fragment.cycle, node, _NOBODY, number, fragment.frame_id, place.channel
                )
                time_us = bus.timebase.begins_us(fragment.cycle) + place.start_us
                frames.append(FrameOnBus(data, way, count, place, time_us))
            case Event() as event:
                events.append(event)
    standing = _standing(events, len(trace.payload_bytes))
    traffic = Traffic(bus, build_faults(setup, bus), frames, standing)
    return traffic._replace(frames=list(_with_tries(traffic, bus))) if retransmits(bus) else traffic


def _with_tries(traffic: Traffic, bus: Retransmits) -> Iterator[FrameOnBus]:
    """Yield the frames of all cycles with the tries that end in an error."""
    ordered = sorted(traffic.frames, key=lambda one: (one.way.cycle, one.place.start_us))
    for _, cycle in groupby(ordered, key=lambda one: one.way.cycle):
        frames = list(cycle)
        failed = [
            failed_tries(traffic.faults(one.way.step), one.way, traffic.bus.schedule)
            for one in frames
        ]
        delays = bus.delays_us([one.place for one in frames], failed)
        for one, tries, delay_us in zip(frames, failed, delays, strict=True):
            yield one._replace(
                time_us=one.time_us + delay_us,
                failed=tries,
                failed_us=bus.failed_us(one.place.payload_bytes),
            )


def error_frames(frame: FrameOnBus) -> Iterator[Captured]:
    """Yield the tries of a frame that end in an error."""
    for place in range(frame.failed):
        time_us = frame.time_us + place * frame.failed_us
        yield Captured(time_us, frame.data, frame.place.channel, collision=True)


def on_the_wire(traffic: Traffic, frame: FrameOnBus) -> Iterator[Captured]:
    """Yield a frame on each channel that carries it."""
    way, formats = frame.way, traffic.bus.frame_format
    faults = traffic.faults(way.step)
    if not faults.standing:
        for channel in frame.place.channel:
            yield Captured(frame.time_us, formats.on_channel(frame.data, channel), channel)
        return
    yield from error_frames(frame)
    if is_given_up(faults, frame.failed):
        return
    if frame.failed:
        faults = without_errors(faults)
    whole = sent(faults, way.step, way.cycle, way.sender, way.number, frame.data, traffic.bus)
    collision = collides(faults, way, traffic.bus.schedule)
    for channel in frame.place.channel:
        if carries(faults, way, channel):
            body = on_channel(formats, whole, channel)
            yield Captured(frame.last_us, body, channel, collision)


def on_channel(frames: FrameFormat, data: bytes, channel: str) -> bytes:
    """Return a frame with the checksum of its channel, wrong if it was wrong."""
    try:
        return frames.on_channel(data, channel)
    except FrameError:
        # A broken controller turns the last bit over.
        right = data[:-1] + bytes([data[-1] ^ _LAST_BIT])
        turned = frames.on_channel(right, channel)
        return turned[:-1] + bytes([turned[-1] ^ _LAST_BIT])


def _standing(events: Sequence[Event], steps: int) -> list[Standing]:
    """The sum of all changes in each step."""
    standing, found = UNCHANGED, []
    for step in range(steps):
        for event in events:
            if event.step == step:
                standing = after(standing, step, event.change)
        found.append(standing)
    return found


def _unused_slots(traffic: Traffic) -> Iterator[Captured]:
    """Yield null frames in static slots that shares were too short for."""
    bus = traffic.bus
    if not isinstance(bus, FlexRayBus):
        return
    used: dict[int, set[tuple[int, int]]] = {}
    whole: dict[int, set[int]] = {}
    came: Counter[tuple[int, int]] = Counter()
    for frame in traffic.frames:
        cycle, node = frame.way.cycle, frame.way.sender
        used.setdefault(cycle, set()).add((node, frame.place.frame_id))
        came[cycle, node] += 1
        # A node that has sent nothing leaves gaps, and of a cut share the rest is not known.
        if came[cycle, node] == frame.frames:
            whole.setdefault(cycle, set()).add(node)
    for cycle, nodes in whole.items():
        yield from _null_frames(bus, cycle, bus.timebase.bus_cycle(cycle), nodes, used[cycle])


def _between_steps(traffic: Traffic, steps: int, rounds: int) -> Iterator[Captured]:
    """Yield the null frames of all cycles that carry no round."""
    bus = traffic.bus
    if not isinstance(bus, FlexRayBus):
        return
    first = [bus.timebase.bus_cycle(step * rounds) for step in range(steps)]
    for number in range(ceil(bus.timebase.cycles_of(steps))):
        step = max(0, bisect_right(first, number) - 1)
        if first[step] <= number < first[step] + rounds:
            continue
        faults, absent = traffic.faults(step), traffic.standing[step].absent
        last = (step + 1) * rounds - 1
        nodes = [
            node
            for node in range(bus.schedule.nodes)
            if node not in absent and not sends_nothing(faults, step, last, node)
        ]
        yield from _null_frames(bus, number, number, nodes)


def _null_frames(
    bus: FlexRayBus,
    turn: int,
    number: int,
    nodes: Collection[int],
    sent: Collection[tuple[int, int]] = (),
) -> Iterator[Captured]:
    """Yield the null frames of these nodes in cycle `number` of the bus."""
    for place, data in bus.null_frames(turn, number, sent):
        if place.node in nodes:
            time_us = number * bus.cycle_us + place.start_us
            for channel in place.channel:
                yield Captured(time_us, bus.frame_format.on_channel(data, channel), channel)
