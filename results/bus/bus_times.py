"""Times on a bus: when which share was sent in one run, and how long a step's shares take."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from concord.bus.bus import Bus, Transmission
from concord.results.bus.sent_shares import SentShares
from concord.results.records.runs import Runs
from concord.runtime.batched.build import changes_of
from concord.scenarios.build import build_bus


class BusTimes(NamedTuple):
    """Times on the bus.

    `bus_cycle` (steps, rounds) numbers the cycles that carry rounds among all of the bus, from the
    beginning of the run. `load` (steps, rounds) is that of the busier channel. `delay_us` (steps,)
    counts from the measurement to the last share. `share_start_us` and `share_end_us` (steps,
    rounds, N) are the times of a share's first and last bit. They count from the start of the
    cycle; NaN means that no share was sent.
    """

    bus_cycle: np.ndarray
    load: np.ndarray
    delay_us: np.ndarray
    share_start_us: np.ndarray
    share_end_us: np.ndarray


def times_of(runs: Runs) -> BusTimes | None:
    """When what was on the bus in one run; None where the bus has no time, or was another."""
    bus = build_bus(runs.setup)
    return bus_times(bus, shares_of(runs)) if has_times(bus, runs) else None


def shares_of(runs: Runs) -> SentShares:
    """The shares that the nodes sent in the first of some runs."""
    cut = None if runs.cut is None else runs.cut[0]
    return SentShares(runs.payload_bytes[0], np.asarray(runs.classes[0]), cut)


def has_times(bus: Bus, runs: Runs) -> bool:
    """Whether the bus has time, and is the same in the whole of one run."""
    changed = any(change.anew for change in changes_of(runs.setup))
    return bus.has_time and not changed and (runs.history is None or runs.history.one_bus)


def timetable(bus: Bus, sent: SentShares) -> list[tuple[Transmission, ...]]:
    """Return the frames of every cycle from cycle 0 on (`Bus.transmissions`)."""
    numbers = sent.payload_bytes, sent.classes
    rows = (one.reshape(-1, bus.schedule.nodes).tolist() for one in numbers)
    return [bus.transmissions(cycle, *row) for cycle, row in enumerate(zip(*rows, strict=True))]


def cycle_numbers(bus: Bus, cycles: int) -> np.ndarray:
    """The numbers on the bus (cycles,) of the first cycles that carry rounds."""
    return np.array([bus.timebase.bus_cycle(cycle) for cycle in range(cycles)], dtype=np.int64)


def delays_us(bus: Bus, cycles: Sequence[Sequence[Transmission]], rounds: int) -> list[float]:
    """The time of each step from its measurement to its last share."""
    return [
        bus.timebase.wait_us(step) + bus.fusion_delay_us(rounds, last)
        for step, last in enumerate(cycles[rounds - 1 :: rounds])
    ]


def wire_per_step(bus: Bus, sent: SentShares) -> tuple[float, float]:
    """Bytes of all frames with headers and padding, and microseconds, per step: of a bus with time
    on which these shares (steps, rounds, N) were sent."""
    frames = [frame for cycle in timetable(bus, sent) for frame in cycle]
    return on_the_wire(bus, frames, len(sent.payload_bytes))


def on_the_wire(bus: Bus, frames: Sequence[Transmission], steps: float) -> tuple[float, float]:
    """Bytes of frames with headers and padding, and microseconds, per step."""
    overhead_bytes = bus.frame_format.overhead_bytes
    wire_bytes = sum(frame.payload_bytes + overhead_bytes for frame in frames)
    return wire_bytes / steps, sum(frame.end_us - frame.start_us for frame in frames) / steps


def bus_times(bus: Bus, sent: SentShares) -> BusTimes:
    """When what is on a bus with time, on which these shares (steps, rounds, N) were sent."""
    cycles = timetable(bus, sent)
    whole = cycles if sent.cut is None else timetable(bus, sent.whole)
    rounds, nodes = sent.payload_bytes.shape[1:]
    start_us = np.full((len(cycles), nodes), np.nan)
    end_us = np.full((len(cycles), nodes), np.nan)
    for number, cycle in enumerate(whole):
        for frame in cycle:
            start_us[number, frame.node] = np.fmin(start_us[number, frame.node], frame.start_us)
            end_us[number, frame.node] = np.fmax(end_us[number, frame.node], frame.end_us)
    return BusTimes(
        cycle_numbers(bus, len(cycles)).reshape(-1, rounds),
        np.array([bus.load(cycle) for cycle in cycles]).reshape(-1, rounds),
        np.array(delays_us(bus, whole, rounds)),
        start_us.reshape(sent.payload_bytes.shape),
        end_us.reshape(sent.payload_bytes.shape),
    )
