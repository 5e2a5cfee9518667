"""A recorded or made bus signal: at which time it takes which level (high is idle)."""

from collections.abc import Iterable, Mapping
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


class RecordedSignals(NamedTuple):
    """The signals of a file by name, and how many of its lines or changes said nothing."""

    signals: Mapping[str, Waveform]
    unreadable: int

    def signal(self, name: str | None = None) -> Waveform:
        """Return one signal: by name, or the only one whose level changes.

        Raises WaveformError that lists the names if the choice is open or wrong.
        """
        names = ", ".join(repr(one) for one in self.signals)
        if name is not None:
            if name not in self.signals:
                raise WaveformError(f"no column {name!r}; the recording has {names}")
            return self.signals[name]
        moving = [one for one in self.signals.values() if len(one.times_ns) > 1]
        if len(moving) > 1:
            raise WaveformError(
                f"the recording has several signals that change ({names}); choose one with --column"
            )
        return moving[0] if moving else next(iter(self.signals.values()))


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
