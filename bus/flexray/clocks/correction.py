"""Measurement and correction of clocks over one pair of cycles (FlexRay 2.1, 8.5 and 8.6).

The fault-tolerant midpoint (8.6.1) is that of Welch and Lynch (1988).
"""

from typing import NamedTuple

import numpy as np

from concord.bus.arbitration import Numbers
from concord.bus.flexray.clocks.settings import TICK, ClockSettings, Mask

_BEYOND = np.iinfo(np.int64).max
# Fewer values than these leave out none, one and two at either end.
_FEW, _MANY = 3, 8


class CycleTiming(NamedTuple):
    """When the cycle of each node began, and how long it is; arrays (N,).

    Attributes:
        start: in units of `TICK` per microtick, from the nominal start of this cycle.
        rate: rate correction of the cycle, in microticks.
        period: length of the node's own microtick, in units.
    """

    start: Numbers
    rate: Numbers
    period: Numbers


class Deviations(NamedTuple):
    """Deviations in microticks of the sync frames that each node has heard, (N, S)."""

    deviation: Numbers
    known: Mask


class Corrections(NamedTuple):
    """Corrections at the end of an odd cycle, (N,), in microticks.

    `exceeded`: a limit was passed, so the value is that limit. `missing`: of no other
    node both sync frames were heard.
    """

    rate: Numbers
    offset: Numbers
    exceeded: Mask
    missing: Mask


def midpoint(values: Numbers, known: Mask) -> Numbers:
    """Return the mean of the smallest and the largest value after the extremes are left out.

    The extremes are 0, 1 or 2 at either end, for up to 2, up to 7, and more values. An odd sum is
    halved towards zero.

    Args:
        values: (..., S), deviations in microticks.
        known: (..., S), which of them were measured.

    Returns:
        (...), 0 where no value is known.
    """
    count = known.sum(axis=-1, keepdims=True)
    ordered = np.sort(np.where(known, values, _BEYOND), axis=-1)
    out = (count >= _FEW).astype(np.int64) + (count >= _MANY)
    low = np.take_along_axis(ordered, np.minimum(out, np.maximum(count - 1, 0)), axis=-1)
    high = np.take_along_axis(ordered, np.maximum(count - 1 - out, 0), axis=-1)
    some = count[..., 0] > 0
    both = np.where(some, low[..., 0], 0) + np.where(some, high[..., 0], 0)
    return np.sign(both) * (np.abs(both) // 2)


def periods(ppm: Numbers | np.ndarray) -> Numbers:
    """Return the length of a microtick of clocks that are fast by so many millionths."""
    return TICK - np.rint(np.asarray(ppm, dtype=float) * (TICK // 10**6)).astype(np.int64)


def instant(settings: ClockSettings, timing: CycleTiming, macrotick: int) -> Numbers:
    """Return when the clock of each node reaches a macrotick before the idle time, (N,)."""
    elapsed = macrotick * (settings.microticks + timing.rate) // settings.macroticks
    return timing.start + elapsed * timing.period


def arrivals(settings: ClockSettings, timing: CycleTiming, delays: Numbers) -> Numbers:
    """Return when each sync frame reaches each node, (N, S).

    Args:
        delays: (N, S), from the sender to the receiver, in units.
    """
    senders = settings.senders
    elapsed = settings.action_points * (settings.microticks + timing.rate[senders])
    ticks = elapsed // settings.macroticks
    return (timing.start[senders] + ticks * timing.period[senders])[None, :] + delays


def measure(
    settings: ClockSettings, timing: CycleTiming, delays: Numbers, sent: Mask
) -> Deviations:
    """Measure each sync frame that was sent against the node's own schedule.

    A frame that is early or late by more than the action point offset crosses the border of its
    slot, and the node does not use it. A sync node counts its own frame with 0.

    Args:
        delays: (N, S). sent: (S,) or (N, S), whether the frame was sent and not lost.
    """
    ahead = arrivals(settings, timing, delays) - timing.start[:, None]
    expected = settings.action_points * (settings.microticks + timing.rate)[:, None]
    deviation = ahead // timing.period[:, None] - expected // settings.macroticks
    own = np.arange(len(timing.start))[:, None] == settings.senders
    deviation = np.where(own, 0, deviation)
    return Deviations(deviation, sent & (np.abs(deviation) <= settings.window))


def corrections(
    settings: ClockSettings, rate: Numbers, even: Deviations, odd: Deviations
) -> Corrections:
    """Return the corrections from the measurements of an even and an odd cycle.

    Offset: the midpoint of the odd cycle. Rate: the midpoint of the changes from even to odd, added
    to the correction so far, and drawn towards zero by the damping (FlexRay 2.1, 8.6.2 and 8.6.3).
    """
    own = np.arange(len(rate))[:, None] == settings.senders
    pairs = even.known & odd.known
    missing = ~(pairs & ~own).any(axis=-1)
    offset = midpoint(odd.deviation, odd.known)
    wanted = rate + midpoint(odd.deviation - even.deviation, pairs)
    damped = np.sign(wanted) * np.maximum(0, np.abs(wanted) - settings.damping)
    exceeded = (np.abs(damped) > settings.rate_limit) | (np.abs(offset) > settings.offset_limit)
    return Corrections(
        np.where(missing, rate, np.clip(damped, -settings.rate_limit, settings.rate_limit)),
        np.where(missing, 0, np.clip(offset, -settings.offset_limit, settings.offset_limit)),
        exceeded & ~missing,
        missing,
    )


def next_cycle(
    settings: ClockSettings, timing: CycleTiming, rate: Numbers, offset: Numbers
) -> CycleTiming:
    """Return the timing of the next cycle with its rate correction; `offset` lengthens the idle
    time of this one."""
    length = settings.microticks + timing.rate + offset
    start = timing.start + length * timing.period - settings.microticks * TICK
    return timing._replace(start=start, rate=rate)
