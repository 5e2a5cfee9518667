"""Symbols on a recorded bus: low pulses without a frame that start or wake a cluster.

FlexRay protocol specification 2.1, chapters 3 and 7: a collision avoidance or media test symbol is
30 low bits after the start sequence; a wake-up pattern repeats 6 us low and 18 us idle.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from concord.bus.flexray.cluster_parameters import COLLISION_AVOIDANCE_BITS

_LONGEST_CAS_BITS = 99
_WAKE_UP_LOW_NS = (4600, 7000)
_WAKE_UP_IDLE_NS = (15000, 21000)
CAS_OR_MTS = "CAS or MTS"
WAKE_UP = "wake-up pattern"


class LowPulse(NamedTuple):
    """A low pulse on the idle bus, by its edges in nanoseconds."""

    fall_ns: int
    rise_ns: int

    @property
    def length_ns(self) -> int:
        return self.rise_ns - self.fall_ns


class Symbol(NamedTuple):
    """A symbol: its name, its first falling edge, its last rising edge, its low pulses."""

    name: str
    start_us: float
    end_us: float
    pulses: int


def symbols(pulses: Iterable[LowPulse], bit_ns: float) -> tuple[Symbol, ...]:
    """Return the symbols among low pulses that begin no frame, in order of time."""
    found: list[Symbol] = []
    for run in _runs(pulses):
        bits = run[0].length_ns / bit_ns
        if len(run) > 1:
            found.append(_symbol(WAKE_UP, run))
        elif COLLISION_AVOIDANCE_BITS - 1 <= bits <= _LONGEST_CAS_BITS:
            found.append(_symbol(CAS_OR_MTS, run))
    return tuple(found)


def _runs(pulses: Iterable[LowPulse]) -> list[list[LowPulse]]:
    """Runs of pulses that follow each other as in a wake-up pattern; others stand alone."""
    runs: list[list[LowPulse]] = []
    for pulse in pulses:
        last = runs[-1][-1] if runs else None
        follows = (
            last is not None
            and all(_within(p.length_ns, _WAKE_UP_LOW_NS) for p in (last, pulse))
            and _within(pulse.fall_ns - last.rise_ns, _WAKE_UP_IDLE_NS)
        )
        if follows:
            runs[-1].append(pulse)
        else:
            runs.append([pulse])
    return runs


def _within(value: float, span: tuple[float, float]) -> bool:
    return span[0] <= value <= span[1]


def _symbol(name: str, run: Sequence[LowPulse]) -> Symbol:
    return Symbol(name, run[0].fall_ns / 1e3, run[-1].rise_ns / 1e3, len(run))
