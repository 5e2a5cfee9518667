"""Recordings as CSV: a column of times, and a column of levels for each signal.

The heading may name the unit of time, as in `time_ns`, `time_us`, or `Time [s]` of Saleae's Logic.
Lines that begin with `;` or `#` are comments, as sigrok writes them.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from math import isfinite
from typing import Literal, NamedTuple

import numpy as np

from concord.features.flexray_tools.recordings.waveform import (
    MAX_TIME_NS,
    RecordedSignals,
    WaveformError,
    from_samples,
)

Unit = Literal["ns", "us", "ms", "s"]
"""Units of time in a recording."""

NANOSECONDS: dict[str, float] = {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9}
_UNIT = re.compile(r"(?<![a-z])(ns|us|ms|s)(?![a-z])")


class CsvHeading(NamedTuple):
    """Names of the columns, place of the time among them, and its unit where it is said."""

    names: Sequence[str]
    time: int
    unit: str | None


def parse_csv(text: str, unit: Unit | None = None) -> RecordedSignals:
    """Read the signals of CSV text; lines without a time and a level of 0 or 1 are counted.

    `unit` is that of the times; without it the heading decides, and whole numbers without a unit
    are nanoseconds. Raises WaveformError if most lines are unreadable, the unit is open or the time
    goes backwards.
    """
    heading, lines = csv_heading(data_lines(text))
    stated = unit or heading.unit
    scale = NANOSECONDS[stated or "ns"]
    samples: dict[str, tuple[list[int], list[int]]] = {}
    unreadable, fractions = 0, False
    for line in lines:
        fields = line.replace(";", ",").replace("\t", ",").split(",")
        time = _time_ns(fields, heading.time, scale)
        if time is None:
            unreadable += 1
            continue
        found = False
        for place, field in enumerate(fields):
            level = None if place == heading.time else _level(field)
            if level is not None:
                name = heading.names[place] if place < len(heading.names) else str(place)
                times, levels = samples.setdefault(name, ([], []))
                times.append(round(time))
                levels.append(level)
                found = True
        fractions = fractions or (found and stated is None and time != round(time))
        unreadable += not found
    if unreadable >= max(1, len(lines) - unreadable) or not lines:
        volts = _volts(lines)
        if volts is not None:
            raise WaveformError(
                f"the samples look like volts ({volts[0]:g} to {volts[1]:g}); state from which "
                f"voltage on the bus is high, such as --threshold {np.mean(volts):.3g}"
            )
        raise WaveformError(
            f"{unreadable} of {len(lines)} lines are no 'time_ns,level' with level 0 or 1; export "
            "the digital signal as CSV of level changes"
        )
    if fractions:
        raise WaveformError(
            "the times have fractions, but no unit; write it into the heading (time_us,level) or "
            "state it with --unit s, ms, us or ns"
        )
    return RecordedSignals(
        {name: from_samples(*pair) for name, pair in samples.items()}, unreadable
    )


def data_lines(text: str) -> list[str]:
    """Return the lines of CSV text that are no comments."""
    return [line for line in text.splitlines() if line.strip() and line[0] not in ";#"]


def csv_heading(lines: Sequence[str]) -> tuple[CsvHeading, Sequence[str]]:
    """Names of the columns if the first line has them, and the lines of data."""
    if not lines or "time" not in lines[0].lower():
        return CsvHeading((), 0, None), lines
    names = [name.strip().strip('"') for name in re.split("[,;\t]", lines[0])]
    time = next((i for i, name in enumerate(names) if "time" in name.lower()), 0)
    said = names[time].lower().replace("time", "").replace("\N{MICRO SIGN}", "u")
    unit = _UNIT.search(said.replace("\N{GREEK SMALL LETTER MU}", "u"))
    return CsvHeading(names, time, unit and unit[1]), lines[1:]


def _time_ns(fields: Sequence[str], place: int, scale: float) -> float | None:
    """The time of a line, or None if it does not say one."""
    try:
        time = float(fields[place]) * scale
    except (ValueError, IndexError):
        return None
    return time if abs(time) <= MAX_TIME_NS else None


def _volts(lines: Sequence[str]) -> tuple[float, float] | None:
    """Return the lowest and highest value where the last column has numbers that are no levels."""
    values: list[float] = []
    for line in lines:
        with suppress(ValueError):
            values.append(float(re.split("[,;\t]", line)[-1]))
    values = [value for value in values if isfinite(value)]
    enough = 2 * len(values) > len(lines) and max(values) > min(values)
    return (min(values), max(values)) if enough else None


def _level(field: str) -> int | None:
    try:
        level = float(field)
    except ValueError:
        return None
    return int(level) if level in (0.0, 1.0) else None
