"""A recorded or made bus signal: at which time it takes which level.

As text: CSV of `time_ns,level`, one line for each change of level (high is idle).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_TIME_NS = 2**62


class WaveformError(ValueError):
    """A recording that cannot be read as a digital FlexRay signal."""


class Waveform(NamedTuple):
    """Changes of level: `times_ns` (k,) int64, rising; `levels` (k,) uint8, alternating 0 and 1."""

    times_ns: NDArray[np.int64]
    levels: NDArray[np.uint8]

    def inverted(self) -> "Waveform":
        return Waveform(self.times_ns, 1 - self.levels)


class Reading(NamedTuple):
    """A waveform and how many lines of its file said nothing (a cut last line, say)."""

    waveform: Waveform
    unreadable_lines: int


def parse_waveform(text: str) -> Reading:
    """Read CSV text of `time_ns,level`; a heading is optional, unreadable lines are counted.

    Raises WaveformError if most lines are unreadable or the time goes backwards.
    """
    times: list[int] = []
    levels: list[int] = []
    lines = [line for line in text.splitlines() if line.strip()]
    if lines and "time" in lines[0].lower():
        lines = lines[1:]
    for line in lines:
        sample = _sample(line)
        if sample is not None:
            times.append(sample[0])
            levels.append(sample[1])
    unreadable = len(lines) - len(times)
    if unreadable >= max(1, len(times)):
        raise WaveformError(
            f"{unreadable} of {len(lines)} lines are no 'time_ns,level' with level 0 or 1; export "
            "the digital signal as CSV of level changes in nanoseconds"
        )
    return Reading(from_samples(times, levels), unreadable)


def from_samples(times_ns: Iterable[int], levels: Iterable[int]) -> Waveform:
    """A waveform of samples in order of time; samples that repeat a level are dropped.

    Raises WaveformError if the time goes backwards.
    """
    times = np.asarray(list(times_ns), dtype=np.int64)
    values = np.asarray(list(levels), dtype=np.uint8)
    backwards = np.flatnonzero(np.diff(times) < 0)
    if backwards.size:
        late, early = times[backwards[0]], times[backwards[0] + 1]
        raise WaveformError(
            f"the time goes backwards, from {late} to {early} ns; sort the recording, and export "
            "one channel only"
        )
    # Of several samples at one time the last one is what the signal became.
    kept = np.append(times[1:] != times[:-1], True)[: len(times)]
    times, values = times[kept], values[kept]
    changed = np.append(True, values[1:] != values[:-1])[: len(values)]
    return Waveform(times[changed], values[changed])


def without_spikes(waveform: Waveform, shortest_ns: float) -> Waveform:
    """The signal without pulses shorter than this, as a receiver's majority vote has it."""
    times: list[int] = []
    levels: list[int] = []
    for time, level in zip(waveform.times_ns.tolist(), waveform.levels.tolist(), strict=True):
        if times and time - times[-1] < shortest_ns:
            times.pop()
            levels.pop()
        else:
            times.append(time)
            levels.append(level)
    return Waveform(np.array(times, dtype=np.int64), np.array(levels, dtype=np.uint8))


def _sample(line: str) -> tuple[int, int] | None:
    """Time in ns and level of a line, or None if it does not say so."""
    fields = line.split(",")
    try:
        time, level = round(float(fields[0])), float(fields[1])
    except (ValueError, IndexError, OverflowError):
        return None
    if level not in (0.0, 1.0) or abs(time) > MAX_TIME_NS:
        return None
    return time, int(level)
