"""Which series of which log file is which quantity, in which unit and with which stamps."""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import msgspec
import numpy as np

from concord.plants.recorded.channels import ChannelReadings, channel_of
from concord.plants.recorded.log_files import LogFile, open_log

Map = TypeVar("Map", bound="LogMap")

UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "m": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "m/s": 1.0,
    "km/h": 1 / 3.6,
    "mph": 0.44704,
    "kn": 1852 / 3600,
    "m/s2": 1.0,
    "g": 9.81,
}
"""Factor from a unit to SI."""
_ALIKE = (
    ("s", "ms", "us", "ns"), ("m",), ("rad", "deg"), ("rad/s", "deg/s"),
    ("m/s", "km/h", "mph", "kn"), ("m/s2", "g"),
)  # fmt: skip
"""Units of one quantity, that of SI first."""


class Stamps(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A series of a file: what is meant is scale * (number in SI) + offset.

    A sensor whose axes point the other way has scale = -1.
    """

    column: str
    unit: str
    scale: float = 1.0
    offset: float = 0.0

    def in_si(self, raw: np.ndarray) -> np.ndarray:
        """Return what numbers of the file mean."""
        return self.scale * UNITS[self.unit] * raw + self.offset


class Column(Stamps, frozen=True, forbid_unknown_fields=True):
    """Readings of one quantity.

    Attributes:
        file: that holds them, in the folder; None for the map's.
        time: their stamps, in the same file; None for those of the file, else the map's.
        delay_s: from the instant of a reading to its stamp.
    """

    file: str | None = None
    time: Stamps | None = None
    delay_s: float = 0.0


class LogMap(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of maps from quantities to columns; a map adds a field for each quantity.

    Attributes:
        file: that holds a column which names no other.
        time: stamps of CSV columns which name no other.
        si_units: of the quantities that can have no other unit.
    """

    si_units: ClassVar[Mapping[str, str]] = {}
    file: str = "drive.csv"
    time: Stamps | None = None

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
        wanted = "s" if quantity.startswith("time") else kind.si_units.get(quantity)
        alike = next((some for some in _ALIKE if some[0] == wanted), tuple(UNITS))
        if series is not None and series.unit not in alike:
            raise ValueError(
                f"the column map gives {quantity} in {series.unit!r}; units are {', '.join(alike)}"
            )
    return columns


def read_channels(
    folder: str | Path, columns: Mapping[str, Column], default: LogMap
) -> dict[str, ChannelReadings]:
    """Return the channels of columns by their quantities, each file read once.

    Args:
        folder: of the files that the columns name.
        columns: of the quantities.
        default: file and time of a column that names none.

    Raises:
        ValueError: naming file and cure, for what is missing or cannot be read.
    """
    files: dict[str, LogFile] = {}
    channels = {}
    for quantity, column in columns.items():
        name = column.file or default.file
        if name not in files:
            files[name] = open_log(Path(folder) / name)
        try:
            channels[quantity] = _channel(files[name], quantity, column, default)
        except ValueError as error:
            raise ValueError(f"{Path(folder) / name}: {error}") from None
    return channels


def _channel(file: LogFile, quantity: str, column: Column, default: LogMap) -> ChannelReadings:
    values = column.in_si(_series(file, quantity, column.column))
    stamps_s = file.stamps_s(column.column) if column.time is None else None
    if stamps_s is None:
        time = column.time or default.time
        if time is None:
            raise ValueError(
                f"no time for {quantity}; name the column of its stamps in the column map: "
                'time = { column = "...", unit = "s" }'
            )
        stamps_s = time.in_si(_series(file, f"time of {quantity}", time.column))
    if len(stamps_s) != len(values):
        raise ValueError(
            f"{column.column!r} for {quantity} has {len(values)} entries, but {len(stamps_s)} "
            "stamps; name its own stamps as its time"
        )
    try:
        return channel_of(stamps_s - column.delay_s, values)
    except ValueError as error:
        raise ValueError(f"{column.column!r} for {quantity}: {error}") from None


def _series(file: LogFile, quantity: str, name: str) -> Any:
    if name not in file.names:
        there = ", ".join(file.names) or "none, for the file is empty"
        raise ValueError(f"no column {name!r} for {quantity}; there are {there}")
    return file.series(name)
