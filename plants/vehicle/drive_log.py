"""Reader of logged drives: a CSV file, a map of its columns, and the parameters of the car.

A folder holds `drive.csv` (a line of column names, then numbers), `columns.toml` (which column is
what, in which unit) and `car.toml` (`vehicle_parameters.Car`).
"""

import csv
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np

from concord.plants.vehicle.drive import REAR_LEFT, REAR_RIGHT, Drive
from concord.plants.vehicle.parameters import GRAVITY_M_S2, Car, car_from_toml, car_to_toml

T = TypeVar("T")

DRIVE, COLUMNS, CAR = "drive.csv", "columns.toml", "car.toml"

UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "rad": 1.0,
    "deg": math.pi / 180,
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "m/s": 1.0,
    "km/h": 1 / 3.6,
    "mph": 0.44704,
    "m/s2": 1.0,
    "g": GRAVITY_M_S2,
}
"""Factor from a unit to SI."""

_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
_UNEVEN = 0.01  # of a sample: logs are stamped with a little jitter
_LONGEST_GAP = 5.0  # samples that may be interpolated


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A column of the file: what is meant is scale * (number in SI) + offset.

    A sensor whose axes point the other way has scale = -1.
    """

    column: str
    unit: str
    scale: float = 1.0
    offset: float = 0.0


class ColumnMap(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which column is what; ISO 8855 axes (left is positive).

    Steering is the road wheels' or the steering wheel's, whose angle the car's ratio divides. Speed
    is the car's own, or the mean of the rear wheels'.
    """

    time: Column
    yaw_rate: Column
    steering: Column | None = None
    steering_wheel: Column | None = None
    speed: Column | None = None
    front_left_wheel: Column | None = None
    front_right_wheel: Column | None = None
    rear_left_wheel: Column | None = None
    rear_right_wheel: Column | None = None
    lateral_acceleration: Column | None = None
    longitudinal_acceleration: Column | None = None
    side_slip: Column | None = None


class LoggedDrive(NamedTuple):
    """A drive and the car that drove it."""

    drive: Drive
    car: Car


def read_folder(folder: str | Path) -> LoggedDrive:
    """Return the logged drive of a folder.

    Raises:
        ValueError: naming file and cure, for what is missing or cannot be read.
    """
    folder = Path(folder)
    car = read_car(folder)
    columns = _from_toml(folder / COLUMNS, columns_from_toml)
    return LoggedDrive(read_drive(folder / DRIVE, columns, car.steering_ratio), car)


def read_car(folder: str | Path) -> Car:
    """Return the car of such a folder.

    Raises:
        ValueError: as `read_folder`.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(
            f"{folder}: no such folder; give one that holds {DRIVE}, {COLUMNS} and {CAR}"
        )
    return _from_toml(folder / CAR, car_from_toml)


def _from_toml(file: Path, read: Callable[[str], T]) -> T:
    text = _text(file)
    try:
        return read(text)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def columns_from_toml(text: str) -> ColumnMap:
    """Return the map that a TOML text describes, one line per quantity:

        yaw_rate = { column = "YawRate", unit = "deg/s" }

    Raises:
        ValueError: not TOML, a field that is unknown or missing, a unit that is not in `UNITS`, no
            steering or no speed.
    """
    try:
        columns = msgspec.convert(tomllib.loads(text), ColumnMap)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"the column map is not TOML: {error}") from error
    except msgspec.ValidationError as error:
        raise ValueError(f"the column map is not valid: {error}") from error
    for quantity, column in _mapped(columns).items():
        if column.unit not in UNITS:
            raise ValueError(
                f"the column map gives {quantity} in {column.unit!r}; units are {', '.join(UNITS)}"
            )
    if columns.steering is None and columns.steering_wheel is None:
        raise ValueError("the column map has neither steering nor steering_wheel; name a column")
    if columns.speed is None and None in (columns.rear_left_wheel, columns.rear_right_wheel):
        raise ValueError("the column map has neither speed nor both rear wheels; name columns")
    return columns


def read_drive(file: str | Path, columns: ColumnMap, steering_ratio: float = 1.0) -> Drive:
    """Return the drive in a CSV file; NaN for what it does not say.

    Uneven times are interpolated to their median spacing; what lies in a gap of more than five
    samples is NaN.

    Args:
        file: UTF-8, a line of column names, then numbers, commas between; an empty field is NaN.
        columns: which column is what.
        steering_ratio: steering-wheel angle over road-wheel angle.

    Raises:
        ValueError: naming file, line and cure.
    """
    file = Path(file)
    mapped = _mapped(columns)
    read = _numbers(file, mapped)
    times = read.pop("time")
    if len(times) < 2 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ValueError(
            f"{file}: column {columns.time.column!r} must hold at least two times that grow from "
            "line to line; sort the lines and drop repeated ones"
        )
    time_step_s = float(np.median(np.diff(times)))
    even = {name: _evenly(times, values, time_step_s) for name, values in read.items()}
    unknown = np.full(len(_grid(times, time_step_s)), np.nan)
    wheels = np.stack(
        [even.get(f"{wheel}_wheel", unknown) for wheel in _WHEELS],
        axis=-1,
    )
    steering = even.get("steering")
    if steering is None:
        steering = even["steering_wheel"] / steering_ratio
    return Drive(
        time_step_s=time_step_s,
        steering_rad=steering,
        yaw_rate_rad_s=even["yaw_rate"],
        side_slip_rad=even.get("side_slip", unknown),
        speed_m_s=even.get("speed", 0.5 * (wheels[:, REAR_LEFT] + wheels[:, REAR_RIGHT])),
        longitudinal_acceleration_m_s2=even.get("longitudinal_acceleration", unknown),
        lateral_acceleration_m_s2=even.get("lateral_acceleration", unknown),
        wheel_speed_m_s=wheels,
        heading_rad=unknown,
    )


def _mapped(columns: ColumnMap) -> dict[str, Column]:
    fields = msgspec.structs.asdict(columns)
    return {name: column for name, column in fields.items() if column is not None}


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8-sig")  # some programs begin a file with its mark
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror}); a drive needs it") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{file}: byte {error.start} is not UTF-8 text; save the file as UTF-8"
        ) from None


def _numbers(file: Path, mapped: dict[str, Column]) -> dict[str, np.ndarray]:
    """Return the mapped quantities (rows,) in SI."""
    rows = list(csv.reader(_text(file).splitlines()))
    names = [name.strip() for name in rows[0]] if rows else []
    if len(names) == 1 and any(sign in names[0] for sign in ";\t"):
        raise ValueError(
            f"{file}: the first line has semicolons or tabs and no comma; separate fields by "
            "commas, and write decimals with a point"
        )
    for quantity, column in mapped.items():
        if column.column not in names:
            there = ", ".join(names) or "none, for the file is empty"
            raise ValueError(
                f"{file}: no column {column.column!r} for {quantity}; there are {there}"
            )
    read = {}
    for quantity, column in mapped.items():
        place = names.index(column.column)
        raw = np.array([_number(file, line, row, place) for line, row in enumerate(rows[1:], 2)])
        read[quantity] = column.scale * UNITS[column.unit] * raw + column.offset
    return read


def _number(file: Path, line: int, row: list[str], place: int) -> float:
    try:
        return float(row[place]) if row[place].strip() else math.nan
    except (IndexError, ValueError):
        raise ValueError(
            f"{file}:{line}: field {place + 1} of {','.join(row)[:60]!r} is not a number; "
            "repair or remove the line"
        ) from None


def _grid(times: np.ndarray, time_step_s: float) -> np.ndarray:
    return times[0] + time_step_s * np.arange(int((times[-1] - times[0]) / time_step_s + 1.5))


def _evenly(times: np.ndarray, values: np.ndarray, time_step_s: float) -> np.ndarray:
    """Values at even times; as they are where the times are even already."""
    grid = _grid(times, time_step_s)
    if len(grid) == len(times) and np.abs(times - grid).max() <= _UNEVEN * time_step_s:
        return values
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.full(len(grid), np.nan)
    stamps = times[known]
    after = np.clip(np.searchsorted(stamps, grid), 1, len(stamps) - 1)
    gap = stamps[after] - stamps[after - 1]
    beside = np.minimum(np.abs(grid - stamps[after]), np.abs(grid - stamps[after - 1]))
    told = (gap <= _LONGEST_GAP * time_step_s) | (beside <= _UNEVEN * time_step_s)
    interpolated = np.interp(grid, stamps, values[known], left=np.nan, right=np.nan)
    return np.where(told, interpolated, np.nan)


def write_drive(folder: Path, drive: Drive, car: Car) -> None:
    """Write a drive as a folder that `read_folder` reads; numbers in SI, NaN as empty fields."""
    quantities = {
        "time": ("s", drive.time_s),
        "steering": ("rad", drive.steering_rad),
        "yaw_rate": ("rad/s", drive.yaw_rate_rad_s),
        "speed": ("m/s", drive.speed_m_s),
        **{
            f"{wheel}_wheel": ("m/s", speed)
            for wheel, speed in zip(_WHEELS, drive.wheel_speed_m_s.T, strict=True)
        },
        "lateral_acceleration": ("m/s2", drive.lateral_acceleration_m_s2),
        "longitudinal_acceleration": ("m/s2", drive.longitudinal_acceleration_m_s2),
        "side_slip": ("rad", drive.side_slip_rad),
    }
    with (folder / DRIVE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(quantities)
        columns = [values.tolist() for _, values in quantities.values()]
        for row in zip(*columns, strict=True):
            writer.writerow("" if math.isnan(value) else repr(value) for value in row)
    lines = [
        f'{name} = {{ column = "{name}", unit = "{unit}" }}\n'
        for name, (unit, _) in quantities.items()
    ]
    (folder / COLUMNS).write_text("".join(lines), encoding="utf-8")
    (folder / CAR).write_text(car_to_toml(car), encoding="utf-8")
