"""Which series of which log file is which quantity, in which unit and with which stamps."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar, TypeVar

import msgspec
import numpy as np

from concord.plants.recorded.channels import ChannelReadings, channel_of
from concord.plants.recorded.log_file import LogFile, say
from concord.plants.recorded.log_files import open_log
from concord.plants.recorded.units import ALIKE, UNITS

Map = TypeVar("Map", bound="LogMap")
# Programs write such a number for none: all bits of an integer, or what no sensor reads.
_FULL_SCALE = frozenset(
    one
    for bits in (8, 16, 32)
    for one in (2.0**bits - 1, 2.0 ** (bits - 1) - 1, -(2.0 ** (bits - 1)))
) | {9999.0, -9999.0, 99999.0, -99999.0, -999.0}
_BYTE = 255
_HUGE = 1e30
# The same number again and again so far from all others is no reading of a sound sensor.
_FAR_DEVIATIONS, _FAR_SPANS = 100.0, 10.0
# Pulses repeat a smaller number too.
_LEAST_REPEATED = 1000.0
# Of its size: values of several meanings, such as 65534 and 65535, lie so near each other.
_NEIGHBOURS = 0.01
# A number of more than a fifth of all readings is a level.
_MOST_SHARE = 0.2


class Stamps(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A series of a file: what is meant is scale * (number in the quantity's unit) + offset.

    A sensor whose axes point the other way has scale = -1.

    Attributes:
        column: name of the series.
        unit: of its numbers; None for the one that the file gives.
        scale: without a unit.
        offset: in the quantity's unit, which is that of SI or the user's own.
    """

    column: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


class Column(Stamps, frozen=True, forbid_unknown_fields=True):
    """Readings of one quantity.

    Attributes:
        file: that holds them, in the folder; None for the map's.
        time: their stamps, in the same file; None for those of the file, else the map's.
        delay_s: from the instant of a reading to its stamp.
        not_available: numbers of the series that stand for none; None for the map's.
    """

    file: str | None = None
    time: Stamps | None = None
    delay_s: float = 0.0
    not_available: tuple[float, ...] | None = None


class LogMap(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of maps from quantities to columns; a map adds a field for each quantity.

    Attributes:
        file: that holds a column which names no other.
        time: stamps of CSV columns which name no other.
        not_available: numbers that stand for none in every series. Where None says what they are,
            a log that seems to have such numbers is refused.
        si_units: of the quantities that can have no other unit.
    """

    si_units: ClassVar[Mapping[str, str]] = {}
    file: str = "drive.csv"
    time: Stamps | None = None
    not_available: tuple[float, ...] | None = None

    @property
    def columns(self) -> dict[str, Column]:
        """The columns of the map by their quantities."""
        fields = msgspec.structs.asdict(self)
        return {name: column for name, column in fields.items() if isinstance(column, Column)}


def map_from_toml(text: str, kind: type[Map]) -> Map:
    """Return the map that a TOML text describes, one line per quantity:

        yaw_rate = { column = "YawRate", unit = "deg/s" }

    Raises:
        ValueError: not TOML, a field that is unknown or missing, or a unit of another quantity.
    """
    try:
        columns = msgspec.convert(tomllib.loads(text), kind)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"the column map is not TOML: {error}") from error
    except msgspec.ValidationError as error:
        raise ValueError(f"the column map is not valid: {error}") from error
    times = {f"time of {name}": column.time for name, column in columns.columns.items()}
    for quantity, series in {"time": columns.time, **times, **columns.columns}.items():
        if kind.si_units.get(quantity) == "":
            _refuse_unit(quantity, series)
            continue
        alike = _units_of(quantity, kind.si_units)
        if series is not None and series.unit not in (None, *alike):
            raise ValueError(
                f"the column map gives {quantity} in {series.unit!r}; units are {', '.join(alike)}"
            )
    return columns


def _refuse_unit(quantity: str, series: Stamps | None) -> None:
    if series is not None and series.unit not in (None, "", "1"):
        raise ValueError(
            f"the column map gives {quantity} in {series.unit!r}, which has no unit in the "
            f"scenario; write {series.unit!r} in the sensor's channels or in state_units, or leave "
            "the unit out of the map"
        )


def read_channels(
    folder: str | Path,
    columns: Mapping[str, Column],
    default: LogMap,
    opened: Mapping[Path, LogFile] = MappingProxyType({}),
) -> dict[str, ChannelReadings]:
    """Return the channels of columns by their quantities, each file read once.

    Args:
        folder: of the files that the columns name.
        columns: of the quantities.
        default: file and time of a column that names none.
        opened: files that are open already.

    Raises:
        ValueError: naming file and cure, for what is missing or cannot be read.
    """
    files = dict(opened)
    channels = {}
    notes: dict[tuple[Path, str], list[str]] = {}
    for quantity, column in columns.items():
        path = Path(folder) / (column.file or default.file)
        if path not in files:
            files[path] = open_log(path)
            if unread := files[path].unread:
                say(f"{path}: skipped what cannot be decoded: {', '.join(unread)}")
        try:
            channels[quantity], happened = _channel(files[path], quantity, column, default)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        for note in happened:
            notes.setdefault((path, note), []).append(quantity)
    for (path, note), quantities in notes.items():
        say(f"{path}: {note} ({', '.join(quantities)})")
    return channels


def _channel(
    file: LogFile, quantity: str, column: Column, default: LogMap
) -> tuple[ChannelReadings, list[str]]:
    """Return the channel of a column, and what was mended in it."""
    values = _in_si(file, quantity, column, default)
    missing = _not_available(file.series(column.column), quantity, column, default)
    values = np.where(missing, np.nan, values)
    stamps_s = file.stamps_s(column.column) if column.time is None else None
    if stamps_s is None:
        time = column.time or default.time
        if time is None:
            raise ValueError(
                f"no time for {quantity}; name the column of its stamps in the column map: "
                'time = { column = "...", unit = "s" }'
            )
        stamps_s = _in_si(file, f"time of {quantity}", time, default)
    if len(stamps_s) != len(values):
        raise ValueError(
            f"{column.column!r} for {quantity} has {len(values)} entries, but {len(stamps_s)} "
            "stamps; name its own stamps as its time"
        )
    try:
        channel = channel_of(stamps_s - column.delay_s, values, file.place)
    except ValueError as error:
        raise ValueError(f"{column.column!r} for {quantity}: {error}") from None
    read = np.isfinite(values)
    repeated = int(read.sum()) - len(channel.values)
    early = int((np.diff(stamps_s[read]) < 0).sum())
    notes = [f"{repeated} equal readings of one stamp came again, and count once"] * (repeated > 0)
    sorted_by = f"{early} readings have an earlier stamp than the one before; sorted by stamps"
    notes += [sorted_by] * (early > 0)
    if missing.any():
        notes.append(f"{int(missing.sum())} readings say that there is none, and are left out")
    elif _said_not_available(column, default):
        notes.append("no reading is one of not_available")
    return channel, notes


def _said_not_available(column: Column, default: LogMap) -> tuple[float, ...] | None:
    """The numbers that stand for none by the column, or else by the map; None where none says."""
    return default.not_available if column.not_available is None else column.not_available


def _not_available(
    numbers: np.ndarray, quantity: str, column: Column, default: LogMap
) -> np.ndarray:
    """Return where (n,) the numbers of a series stand for none.

    Raises:
        ValueError: the map does not say, and a number is there that often does.
    """
    said = _said_not_available(column, default)
    if said is not None:
        # A number of a file may have fewer digits than that of the map.
        near = np.isclose(numbers[:, None], np.array(said, dtype=float), rtol=1e-8, atol=0.0)
        return np.asarray(near.any(axis=1))
    if absent := stands_for_none(numbers):
        none = np.isin(numbers, absent)
        others = numbers[~none]
        values = [f"{value:.12g}" for value in absent]
        raise ValueError(
            f"{column.column!r} for {quantity} is {' or '.join(values)} in {int(none.sum())} of "
            f"{int(np.isfinite(numbers).sum())} readings, which is far from all others "
            f"({np.nanmin(others):.6g} to {np.nanmax(others):.6g}); write not_available = "
            f"[{', '.join(values)}] in the column map if it says that there is none, or "
            "not_available = [] if it is a reading"
        )
    return np.zeros(len(numbers), dtype=bool)


def stands_for_none(numbers: np.ndarray) -> tuple[float, ...]:
    """Return the number in a series (n,) that hardly is a reading, with neighbours that hardly are
    either; none where all may be readings."""
    finite = numbers[np.isfinite(numbers)]
    ends = sorted({float(finite.min()), float(finite.max())}) if len(finite) else []
    for value in ends:
        near = np.abs(finite - value) <= _NEIGHBOURS * abs(value)
        same = near if value in _FULL_SCALE or abs(value) >= _HUGE else finite == value
        if _is_far(value, finite[~same], int(same.sum())):
            return tuple(np.unique(finite[same]).tolist())
    return ()


def _is_far(value: float, others: np.ndarray, count: int) -> bool:
    """Say whether the largest or least number of a series, so often there, is hardly a reading."""
    if not len(others):
        return False
    distance = float(np.abs(others - value).min())
    if abs(value) >= _HUGE:
        return distance >= _HUGE / 2
    if value in _FULL_SCALE and distance > _FAR_SPANS * float(np.abs(others).max()):
        # Of two levels, such as 0 and 255, both may be readings of a switch or a counter.
        return bool(np.ptp(others) > 0) or abs(value) > _BYTE
    is_level = count > _MOST_SHARE * (count + len(others)) or np.ptp(others) == 0
    is_odd = count > 1 and not is_level and abs(value) >= _LEAST_REPEATED
    return is_odd and distance > _FAR_DEVIATIONS * float(np.std(others))


def _in_si(file: LogFile, quantity: str, one: Stamps, default: LogMap) -> np.ndarray:
    """Return what the numbers of a series mean.

    Raises:
        ValueError: no such series, an entry is no number, or file and map give no unit, or two.
    """
    if one.column not in file.names:
        there = ", ".join(file.names) or "none, for the file is empty"
        lost = f" (cannot be decoded: {', '.join(file.unread)})" if file.unread else ""
        raise ValueError(
            f"no column {one.column!r} for {quantity}; there are {there}{lost}; correct the column "
            "map, or add the column to the file"
        )
    told, alike = file.unit(one.column), _units_of(quantity, default.si_units)
    unit = one.unit or told
    if default.si_units.get(quantity) == "":
        # A quantity that the user gave no unit is what the numbers are.
        return one.scale * file.series(one.column) + one.offset
    if unit is None or unit not in alike:
        has = "no unit" if unit is None else f"the unit {unit}"
        raise ValueError(
            f"{one.column!r} for {quantity} has {has}; write unit = with one of {', '.join(alike)} "
            "in the column map"
        )
    if told not in (None, unit):
        raise ValueError(
            f"{one.column!r} for {quantity} is in {told} by the file, but in {unit} by the column "
            f'map; write unit = "{told}" in the map, or correct the file'
        )
    wanted = _wanted(quantity, default.si_units)
    factor = UNITS.get(unit, 1.0) / (1.0 if wanted is None else UNITS.get(wanted, 1.0))
    return one.scale * factor * file.series(one.column) + one.offset


def _units_of(quantity: str, si_units: Mapping[str, str]) -> tuple[str, ...]:
    wanted = _wanted(quantity, si_units)
    # A unit that no other is alike, such as V, is a user's own.
    alone = (wanted,) if wanted else tuple(UNITS)
    return next((some for some in ALIKE if wanted in some), alone)


def _wanted(quantity: str, si_units: Mapping[str, str]) -> str | None:
    """The unit in which a quantity is taken; None for one of SI that no map names."""
    return "s" if quantity.startswith("time") else si_units.get(quantity)
