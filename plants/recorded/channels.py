"""Channels of a log: every reading keeps its own stamp, and a step takes it once.

A reading belongs to the step whose sampling interval holds its stamp, from half a step before the
step to half a step after it. The value is not interpolated. A quantity that changes by d a second
is therefore off by at most d T / 2 at steps T apart, and by d T / sqrt(12) RMS for stamps that lie
anywhere.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from concord.plants.recorded.log_file import say

GAP_SPACINGS = 5.0
"""Median spacings of a channel; a longer interval between two readings is a gap."""
STRAY_S, STRAY_SPACINGS = 3600.0, 1000.0
"""A longer interval, in seconds and in median spacings, is an error of the clock."""
MOST_STEPS = 10_000_000
_ROUNDING = 1e-6  # of a step: a stamp and an instant that lie so near are the same


class ChannelReadings(NamedTuple):
    """Readings of one quantity.

    Attributes:
        stamps_s: (n,), instants of the readings, ascending.
        values: (n,), in SI, finite.
    """

    stamps_s: np.ndarray
    values: np.ndarray

    @property
    def spacing_s(self) -> float:
        """Median interval between readings, infinite for fewer than two."""
        return float(np.median(np.diff(self.stamps_s))) if len(self.values) > 1 else np.inf


class SamplingInstants(NamedTuple):
    """Even instants `start_s` + k `time_step_s` for k from 0 to `steps` - 1."""

    start_s: float
    time_step_s: float
    steps: int

    @property
    def instants_s(self) -> np.ndarray:
        """(steps,)."""
        return self.start_s + self.time_step_s * np.arange(self.steps)


def _numbered(row: int) -> str:
    return f"reading {row + 1}"


def channel_of(
    stamps_s: np.ndarray, values: np.ndarray, place: Callable[[int], str] = _numbered
) -> ChannelReadings:
    """Return the channel of rows (n,), sorted by their stamps; a NaN value is no reading.

    Equal readings of one stamp are one.

    Args:
        stamps_s: (n,).
        values: (n,), in SI.
        place: how an error names a row.

    Raises:
        ValueError: a reading without a stamp, two readings of one stamp, or a stamp that is hours
            from all others.
    """
    rows = np.flatnonzero(np.isfinite(values))
    unstamped = rows[~np.isfinite(stamps_s[rows])]
    if len(unstamped):
        raise ValueError(f"{place(int(unstamped[0]))} has no time; give it one, or remove it")
    rows = rows[np.argsort(stamps_s[rows], kind="stable")]
    again = (np.diff(stamps_s[rows]) == 0) & (np.diff(values[rows]) == 0)
    rows = rows[np.append(True, ~again)] if len(rows) else rows
    spacings_s = np.diff(stamps_s[rows])
    repeated = np.flatnonzero(spacings_s == 0)
    if len(repeated):
        first, second = (place(int(row)) for row in rows[repeated[0] :][:2])
        raise ValueError(
            f"{first} and {second} have the time {stamps_s[rows[repeated[0]]]:.15g} s and other "
            "values, but a reading counts once; drop repeated lines"
        )
    if len(spacings_s):
        usual_s = float(np.percentile(spacings_s, 50, method="lower"))
        far = int(np.argmax(spacings_s))
        if spacings_s[far] > max(STRAY_S, STRAY_SPACINGS * usual_s):
            # Where fewer readings lie on one side, they are the stray ones.
            stray, near = (far, far + 1) if far + 1 < len(rows) / 2 else (far + 1, far)
            side = "before" if stray < near else "after"
            raise ValueError(
                f"{place(int(rows[stray]))} has the time {stamps_s[rows[stray]]:.15g} s, "
                f"{spacings_s[far]:.6g} s {side} the nearest in time ({place(int(rows[near]))}); "
                "remove the stray stamp, or cut the log there and read one part"
            )
    return ChannelReadings(stamps_s[rows], values[rows])


def readings_between(
    channels: Mapping[str, ChannelReadings], start_s: float, end_s: float
) -> dict[str, ChannelReadings]:
    """The readings between two stamps, of channels that have some."""
    within = {
        name: (one.stamps_s >= start_s) & (one.stamps_s <= end_s) for name, one in channels.items()
    }
    return {
        name: ChannelReadings(one.stamps_s[within[name]], one.values[within[name]])
        for name, one in channels.items()
        if within[name].any()
    }


def grid_over(
    channels: Mapping[str, ChannelReadings], time_step_s: float, through: str | None = None
) -> SamplingInstants:
    """Return the instants from the first reading of all channels to the last.

    One of them is the first reading of the channel `through`, or of all channels.

    Raises:
        ValueError: more than `MOST_STEPS` instants, or channels that never read at one time.
    """
    read = {name: one.stamps_s for name, one in channels.items() if len(one.values)}
    _require_one_clock({name: one for name, one in channels.items() if len(one.values)})
    start_s, end_s = min(one[0] for one in read.values()), max(one[-1] for one in read.values())
    if through in read:
        at_s = read[through][0]
        start_s = at_s + time_step_s * _nearest(start_s - at_s, time_step_s)
    if (end_s - start_s) / time_step_s > MOST_STEPS:
        last = max(read, key=lambda name: read[name][-1])
        raise ValueError(
            f"{last} has the time {end_s:.15g} s, a gap of {end_s - start_s:.6g} s to the first "
            f"reading at {start_s:.15g} s, which is more than {MOST_STEPS:,} steps of "
            f"{time_step_s:g} s; correct the unit of the time, or cut the log"
        )
    return SamplingInstants(
        float(start_s), time_step_s, _nearest(end_s - start_s, time_step_s).item() + 1
    )


def _require_one_clock(read: Mapping[str, ChannelReadings]) -> None:
    """Say where some channels have ended before the others begin; refuse it where hours lie
    between.

    Raises:
        ValueError: naming the first channel after such a time.
    """
    in_order = sorted(read, key=lambda name: read[name].stamps_s[0])
    until = in_order[0]
    for name in in_order[1:]:
        begins_s, ended_s = read[name].stamps_s[0], read[until].stamps_s[-1]
        gap_s = begins_s - ended_s
        usual_s = max((one.spacing_s for one in read.values() if len(one.values) > 1), default=0.0)
        apart = (
            f"{name} begins at {begins_s:.15g} s, {gap_s:.6g} s after {until} and all that begins "
            "before it have ended"
        )
        cure = "give one of them an offset of its time in the column map"
        if gap_s > max(STRAY_S, STRAY_SPACINGS * usual_s):
            raise ValueError(f"{apart}: their clocks differ; {cure}, or read one part of the log")
        if gap_s > GAP_SPACINGS * usual_s:
            say(f"{apart}; if their clocks differ, {cure}")
        if read[name].stamps_s[-1] > ended_s:
            until = name


def lateness_s(channel: ChannelReadings, grid: SamplingInstants) -> float:
    """Return by how much readings come after the instants nearest to them, on average."""
    since_s = channel.stamps_s - grid.start_s
    return float(np.mean(since_s - grid.time_step_s * _nearest(since_s, grid.time_step_s)))


def readings_by_step(channel: ChannelReadings, grid: SamplingInstants) -> np.ndarray:
    """Return each reading once, in the row of the instant nearest to its stamp.

    The result is (steps, r), in the order of the stamps and filled up with NaN; r is the largest
    number of readings of one step, at least 1.
    """
    steps = _nearest(channel.stamps_s - grid.start_s, grid.time_step_s)
    rank = np.arange(len(steps)) - np.searchsorted(steps, steps)
    by_step = np.full((grid.steps, int(rank.max(initial=0)) + 1), np.nan)
    by_step[steps, rank] = channel.values
    return by_step


def earlier(readings: np.ndarray, steps: Sequence[Sequence[int]]) -> np.ndarray:
    """Return readings (steps, nodes, r, d) of which each node's and entry's are so many steps
    earlier, later where the number is negative; NaN where none comes."""
    moved = np.full_like(readings, np.nan)
    for node, of_node in enumerate(steps):
        for entry, by in enumerate(of_node):
            whole = readings[:, node, :, entry]
            end = len(whole) - abs(by)
            if end > 0:
                first, last = max(0, -by), max(0, by)
                moved[first : first + end, node, :, entry] = whole[last : last + end]
    return moved


def _nearest(since_start_s: np.ndarray, time_step_s: float) -> np.ndarray:
    return np.floor(since_start_s / time_step_s + 0.5 + _ROUNDING).astype(int)


def mean_by_step(channel: ChannelReadings, grid: SamplingInstants) -> np.ndarray:
    """Return the mean (steps,) of the readings of each step, NaN where there is none."""
    by_step = readings_by_step(channel, grid)
    count = np.isfinite(by_step).sum(axis=1)
    return np.nansum(by_step, axis=1) / np.where(count > 0, count, np.nan)


def interpolated(channel: ChannelReadings, grid: SamplingInstants) -> np.ndarray:
    """Return values (steps,) between readings, for inputs that drive a model.

    They are NaN outside the readings and in a gap of the channel (`GAP_SPACINGS`).
    """
    stamps, instants = channel.stamps_s, grid.instants_s
    if len(stamps) < 2:
        return mean_by_step(channel, grid)
    inside = np.clip(instants, stamps[0], stamps[-1])
    after = np.clip(np.searchsorted(stamps, inside), 1, len(stamps) - 1)
    nearest = np.where(inside - stamps[after - 1] < stamps[after] - inside, after - 1, after)
    at_reading = np.abs(instants - stamps[nearest]) <= _ROUNDING * grid.time_step_s
    gap_s = stamps[after] - stamps[after - 1]
    between = (instants == inside) & (gap_s <= GAP_SPACINGS * channel.spacing_s)
    values = np.where(between, np.interp(instants, stamps, channel.values), np.nan)
    return np.where(at_reading, channel.values[nearest], values)
