"""The columns of a log and a first model of its series, for `concord new --from-log`.

Each series is a state that drifts by itself, read by a node of its own. The noise follows from the
differences of readings. Of a random walk with increments of variance Q, read with variance R, those
of readings m apart have the mean square m Q + 2 R. A smooth motion has none but first differences;
of second and third ones white noise then has the mean squares 6 R and 20 R.
"""

import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from concord.plants.recorded.columns import (
    Column,
    LogMap,
    Stamps,
    read_channels,
    stands_for_none,
)
from concord.plants.recorded.log_file import LogFile
from concord.plants.recorded.log_files import open_log

_MOST_SERIES = 12
_MOST_REASONS = 4
_LEAST, _APART = 4, 10
_TIMES = {
    **dict.fromkeys(("time", "t", "timestamp", "stamp"), None),
    **{f"{name}_{unit}": unit for name in ("time", "t") for unit in ("s", "ms", "us", "ns")},
}
"""Names of columns of stamps, with the unit that a name says."""
_SINCE_1970 = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
_MODEL = '''"""First model of the series of a log: each drifts by itself.

Put what you know in place of `move`, Q and R; `concord run` says what does not fit.
"""

from pathlib import Path

import concord as cc

STEP_S = {step_s!r}


def move(x):
    """Return states (..., {count}) one step later."""
    return x


def series(state):
    """Return the function that reads one state."""
    return lambda x: x[..., state : state + 1]


PLANT = cc.OwnPlant(
    f=move,
    Q={q},
    mean={mean},
    cov={cov},
    time_step_s=STEP_S,
    state_names={names},
    state_units={units},
)
# Standard deviation of the noise of each series, as its readings let one guess.
NOISE = {noise}
SENSORS = [
    cc.OwnSensor(h=series(k), R=std**2, name=name, channels=(("value", unit),))
    for k, (name, unit, std) in enumerate(zip(PLANT.state_names, PLANT.state_units, NOISE))
]
# Without a bus at first: with --bus flexray, cycles must fit into a step.
SCENARIO = cc.own_scenario(
    PLANT, SENSORS, readings=Path(__file__).parent, graph="path"
).with_(bus="ideal", rule="ci")
'''


class _Series(NamedTuple):
    name: str
    column: str
    unit: str
    spacing_s: float
    span_s: float
    mean: float
    cov: float
    drift: float
    noise: float
    not_available: tuple[float, ...]


def first_model(log: Path, folder: Path) -> dict[str, str]:
    """Return the texts of `columns.toml` and `model.py` of a folder, by their names.

    Raises:
        ValueError: the log cannot be read, or has no series with stamps.
    """
    file = open_log(log)
    time = _time_of(file)
    found: list[_Series] = []
    left: dict[str, str] = {}
    stamping = {*file.stamping, *(() if time is None else (time.column,))}
    if again := [name for name in file.names if file.names.count(name) > 1]:
        raise ValueError(f"{log}: column {again[0]!r} is there twice; give each a name of its own")
    for column in (name for name in file.names if name not in stamping):
        if len(found) == _MOST_SERIES:
            left[column] = f"only {_MOST_SERIES} series are taken"
            continue
        try:
            found.append(_series(file, log, column, time, [one.name for one in found]))
        except ValueError as why:
            left[column] = str(why)
    if not found:
        reasons = [f"{name}: {reason}" for name, reason in left.items()]
        more = [f"and {len(reasons) - _MOST_REASONS} more"] if reasons[_MOST_REASONS:] else []
        why = "; ".join(reasons[:_MOST_REASONS] + more)
        cure = "name the column of the stamps time" if why else "give a log that has some"
        raise ValueError(
            f"{log}: no series of numbers with stamps ({why or 'the file has none'}); {cure}"
        )
    for why in dict.fromkeys(left.values()):
        names = [name for name, reason in left.items() if reason == why]
        some = ", ".join(names[:_MOST_REASONS])
        more = f" and {len(names) - _MOST_REASONS} more" if len(names) > _MOST_REASONS else ""
        sys.stderr.write(f"left out: {some}{more} ({why})\n")
    step_s = float(f"{min(one.spacing_s for one in found):.4g}")
    span_s = max(one.span_s for one in found)
    sys.stderr.write(
        f"{len(found)} series with a reading every {step_s:g} s for {span_s:g} s; correct the unit "
        "of the time in columns.toml and STEP_S where that is wrong\n"
    )
    place = os.path.relpath(log, folder)
    return {
        "columns.toml": _columns(place, time, found, left),
        "model.py": _model(step_s, found),
    }


def _time_of(file: LogFile) -> Stamps | None:
    """The column that stamps the others, where the file does not stamp each series itself."""
    named = next((name for name in file.names if name.lower() in _TIMES), None)
    if named is None or named in file.stamping:
        return None
    largest = float(np.nanmax(np.abs(file.series(named)), initial=0.0))
    since = next((unit for least, unit in _SINCE_1970 if largest > least), "s")
    return Stamps(named, file.unit(named) or _TIMES[named.lower()] or since)


def _series(
    file: LogFile, log: Path, column: str, time: Stamps | None, taken: list[str]
) -> _Series:
    unit = file.unit(column) or ""

    class OneSeries(LogMap, frozen=True, kw_only=True, forbid_unknown_fields=True):
        """The map of a single series, in the unit of the file."""

        si_units: ClassVar[Mapping[str, str]] = {"value": ""}

    default = OneSeries(file=log.name, time=time)
    absent = stands_for_none(file.series(column))
    if absent:
        values = " and ".join(f"{value:.12g}" for value in absent)
        sys.stderr.write(f"{column}: {values} is taken for none (not_available)\n")
    known = {"value": Column(column=column, not_available=absent)}
    channel = read_channels(log.parent, known, default, {log.parent / log.name: file})["value"]
    if len(channel.values) < _LEAST:
        raise ValueError(f"it has {len(channel.values)} of the {_LEAST} readings that it needs")
    changes = np.abs(np.diff(channel.values))
    if not changes.any():
        raise ValueError(f"all its readings are {channel.values[0]:g}")
    # Below a quarter of the smallest change, a reading says nothing.
    smallest = float(changes[changes > 0].min(initial=np.inf))
    size = max(float(np.abs(channel.values).max()), 1e-6)
    least = (smallest / 4 if np.isfinite(smallest) else 1e-6 * size) ** 2
    drift, noise = (max(variance, least) for variance in _variances(channel.values))
    return _Series(
        _name_of(column, taken),
        column,
        unit,
        channel.spacing_s,
        float(f"{channel.stamps_s[-1] - channel.stamps_s[0]:.4g}"),
        float(channel.values[0]),
        max(float(np.var(channel.values)), noise),
        drift,
        float(np.sqrt(noise)),
        absent,
    )


def _variances(values: np.ndarray) -> tuple[float, float]:
    """Return the variances of drift from one reading to the next, and of noise."""
    apart = min(_APART, len(values) - 1)
    near, second, third = (float(np.mean(np.diff(values, n=n) ** 2)) for n in (1, 2, 3))
    far = float(np.mean((values[apart:] - values[:-apart]) ** 2))
    # Of a walk this is 2 R too, but with a larger error.
    of_smooth = (third - 3 * second) / 2
    of_walk = (far - near) / (apart - 1)
    if (near - of_walk) / 2 < of_smooth / 2:
        return near - 2 * of_smooth, of_smooth
    return of_walk, (near - of_walk) / 2


def _name_of(column: str, taken: list[str]) -> str:
    """A name of letters, digits and lines that no other series has."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", column).strip("_") or "series"
    name = plain if plain[0].isalpha() else f"series_{plain}"
    number = 2
    while name in taken:
        name, number = f"{plain}_{number}", number + 1
    return name


def _columns(place: str, time: Stamps | None, found: list[_Series], left: dict[str, str]) -> str:
    lines = [f"file = {_quoted(place)}"]
    if time is not None:
        lines.append(f"time = {{ column = {_quoted(time.column)}, unit = {_quoted(time.unit)} }}")
    lines.append("[channels]")
    for one in found:
        unit = f", unit = {_quoted(one.unit)}" if one.unit else ""
        key = _quoted(f"{one.name} value")
        absent = f", not_available = {[*one.not_available]}" if one.not_available else ""
        lines.append(f"{key} = {{ column = {_quoted(one.column)}{unit}{absent} }}")
    lines += [f"# {name}: {' '.join(why.split())}" for name, why in left.items()]
    return "\n".join(lines) + "\n"


def _quoted(text: str | None) -> str:
    # A JSON string is a basic string of TOML.
    return json.dumps(text or "", ensure_ascii=False)


def _model(step_s: float, found: list[_Series]) -> str:
    def numbers(values: list[float]) -> str:
        return "[" + ", ".join(f"{value:.4g}" for value in values) + "]"

    return _MODEL.format(
        step_s=step_s,
        count=len(found),
        q=numbers([one.drift * step_s / one.spacing_s for one in found]),
        mean=[one.mean for one in found],
        cov=numbers([one.cov for one in found]),
        names=tuple(one.name for one in found),
        units=tuple(one.unit for one in found),
        noise=numbers([one.noise for one in found]),
    )
