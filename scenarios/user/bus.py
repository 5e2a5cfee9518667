"""Buses of the user's own: built by a function or class of a file, and checked before the start."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

from concord.bus.arbitration import Arbiter
from concord.bus.bus import Bus, Fragment, FrameFormat, Rejected, Transmission
from concord.bus.flexray.share_frames import SHARE_FRAMES
from concord.bus.schedule import Schedule
from concord.scenarios.types.buses import UserBus
from concord.scenarios.user.values import value_of

MUST = (
    "a function or class build(schedule, share_bytes, arbiter) that gives a Bus (docs/own_plant.md)"
)
_NEEDED = tuple(name for name in vars(Bus) if not name.startswith("_"))
# Cycles that are tried; a long schedule repeats its kinds of cycles.
_TRIED_CYCLES = 64
# Times of frames are sums of numbers like 0.1, so frames may meet to within rounding.
_ROUNDING_US = 1e-6


def user_frame_format(chosen: UserBus) -> FrameFormat:
    """Return `frame_format` of the user's function or class; that of FlexRay where it has none.

    Raises:
        ValueError: the file cannot be read, or its value builds nothing.
    """
    return getattr(_builder(chosen), "frame_format", SHARE_FRAMES)


def user_bus(chosen: UserBus, schedule: Schedule, share_bytes: int, arbiter: Arbiter) -> Bus:
    """Return the bus that the user's function or class makes.

    Raises:
        ValueError: the file cannot be read, its value builds nothing, or fails, or makes no bus.
    """
    try:
        bus = _builder(chosen)(schedule, share_bytes, arbiter)
    # Code of the user may fail in any way.
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise ValueError(f"--bus {chosen.name}: {kind}{error}") from error
    missing = [name for name in _NEEDED if not hasattr(bus, name)]
    if missing:
        raise ValueError(
            f"--bus {chosen.name}: what it builds, a {type(bus).__name__}, has no "
            f"{', '.join(missing)}; derive it from concord.bus.ideal.TimelessBus"
        )
    return bus


def check_user_bus(chosen: UserBus, bus: Bus, schedule: Schedule, share_bytes: int) -> None:
    """Send the longest share of each node through each cycle, and compare what arrives.

    Raises:
        ValueError: naming the promise of `concord.bus.bus.Bus` that the bus breaks.
    """
    if bus.schedule != schedule:
        raise ValueError(
            f"--bus {chosen.name}: its schedule is another one than that of the scenario; keep the "
            "one that it gets"
        )
    if bus.frame_format is not user_frame_format(chosen):
        raise ValueError(
            f"--bus {chosen.name}: its frame_format must be an attribute of what builds it, as of "
            "a class"
        )
    for broken in broken_promises(bus, share_bytes):
        raise ValueError(f"--bus {chosen.name}: {broken}")


def _builder(chosen: UserBus) -> Callable[[Schedule, int, Arbiter], Any]:
    value = value_of(chosen.where)
    if not callable(value):
        raise ValueError(f"{chosen.name}: it is a {type(value).__name__}; it must be {MUST}")
    return value


def broken_promises(bus: Bus, share_bytes: int) -> Iterator[str]:
    """Yield the promises of `concord.bus.bus.Bus` that a bus breaks with its longest shares."""
    schedule = bus.schedule
    if bus.has_time and not bus.cycle_us > 0:
        yield f"has_time with cycle_us {bus.cycle_us:g}; a cycle must take time"
    body = bytes(place * 37 % 256 for place in range(share_bytes))
    for cycle in range(min(schedule.period, _TRIED_CYCLES)):
        owners, asking = schedule.static_senders(cycle), schedule.contenders(cycle)
        for node in (*owners, *asking):
            if wrong := _wrong_share(bus, node, cycle, body):
                yield f"a share of node {node} in cycle {cycle}: {wrong}"
        sending = {*owners, *asking[: schedule.dynamic_slots(cycle)]}
        payload_bytes = [
            sum(bus.payloads(node, cycle, share_bytes)) if node in sending else 0
            for node in range(schedule.nodes)
        ]
        frames = bus.transmissions(cycle, payload_bytes, [0] * schedule.nodes)
        if wrong := _wrong_times(bus, sending, frames):
            yield f"transmissions of cycle {cycle}: {wrong}"
        # Once: trying each byte of every frame would take seconds.
        if cycle == 0 and sending:
            yield from _unnoticed(bus, bus.encode(min(sending), 0, body)[0])


def _wrong_share(bus: Bus, node: int, cycle: int, body: bytes) -> str:
    """Say what is wrong with the frames of a share; empty if nothing is."""
    frames, overhead = bus.encode(node, cycle, body), bus.frame_format.overhead_bytes
    told = bus.payloads(node, cycle, len(body))
    lengths = tuple(len(frame) - overhead for frame in frames)
    if lengths != tuple(told):
        return f"encode makes payloads of {lengths} bytes, and payloads tells {tuple(told)}"
    arrived: dict[int, Fragment] = {}
    for frame in frames:
        try:
            fragment = bus.receive(frame)
            arrived[bus.place(node, fragment).number] = fragment
        except Rejected as error:
            return f"its own frame is rejected ({error.reason})"
        if fragment.cycle != cycle:
            return f"a frame arrives with cycle {fragment.cycle}"
    pieces = [arrived[number].data for number in sorted(arrived)]
    if len(pieces) != len(frames) or bus.frame_format.join(pieces) != body:
        return "the fragments do not join to the body that was sent"
    if len(frames) == 1 and bus.due_body(frames[0], node, cycle, len(body)) != body:
        return "due_body does not know the frame that encode makes"
    return ""


def _unnoticed(bus: Bus, frame: bytes) -> Iterator[str]:
    for place in range(len(frame) if bus.frame_format.noticed_bits else 0):
        broken = bytearray(frame)
        broken[place] ^= 1
        with suppress(Rejected):
            bus.receive(bytes(broken))
            yield f"a wrong bit in byte {place} of a frame is not noticed"


def _wrong_times(bus: Bus, sending: set[int], frames: Sequence[Transmission]) -> str:
    """Say what is wrong with the frames of a cycle; empty if nothing is."""
    if {frame.node for frame in frames} != sending:
        sent = sorted({frame.node for frame in frames})
        return f"it has frames of nodes {sent}, but nodes {sorted(sending)} send"
    end_us = bus.cycle_us if bus.has_time else float("inf")
    ordered = sorted(frames, key=lambda frame: (frame.channel, frame.start_us))
    for frame in ordered:
        if not 0 <= frame.start_us < frame.end_us <= end_us + _ROUNDING_US:
            return f"{_in_words(frame)} is not within the cycle of {end_us:g} us"
    for frame, after in pairwise(ordered):
        if after.channel == frame.channel and after.start_us < frame.end_us - _ROUNDING_US:
            return f"{_in_words(frame)} overlaps that of node {after.node}"
    return ""


def _in_words(frame: Transmission) -> str:
    return f"the frame of node {frame.node}, {frame.start_us:g} to {frame.end_us:g} us,"
