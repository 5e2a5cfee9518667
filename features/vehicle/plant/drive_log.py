"""Logged drives: the files of the readings, a map of their columns, and the car's parameters.

A folder holds `columns.toml` (which column is what, in which unit), the files that it names
(`drive.csv` unless it says otherwise), and `car.toml` (`vehicle_parameters.Car`).
"""

import csv
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.parameters import Car, car_from_toml, car_to_toml
from concord.plants.recorded.channels import (
    ChannelReadings,
    channel_of,
    grid_over,
    interpolated,
    mean_by_step,
)
from concord.plants.recorded.columns import Column, LogMap, map_from_toml, read_channels
from concord.plants.recorded.text_files import text_of

_LONGEST_SPACING_S = 2.0
_JUDGED_READINGS, _ALIKE = 50, 0.8
"""Readings that tell a side, at least, and a correlation that tells it."""


def require_one_drive(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse units and signs of `columns.toml` that no drive can have.

    Raises:
        ValueError: naming the channel and the cure.
    """
    _require_one_clock(channels)
    _require_one_side(channels)


def _require_one_clock(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse channels that never meet, and readings that are far apart."""
    steering = channels["steering"].stamps_s
    for name, (stamps_s, _) in channels.items():
        if len(stamps_s) and max(stamps_s[0], steering[0]) > min(stamps_s[-1], steering[-1]):
            raise ValueError(
                f"{name} was read from {stamps_s[0]:.15g} to {stamps_s[-1]:.15g} s, but "
                f"steering from {steering[0]:.15g} to {steering[-1]:.15g} s, so they never meet; "
                "correct unit and offset of their times"
            )
    if channels["steering"].spacing_s > _LONGEST_SPACING_S:
        raise ValueError(
            f"steering has a reading every {channels['steering'].spacing_s:.3g} s, but a "
            "car is steered within tenths; correct the unit of its time"
        )


def _require_one_side(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse a car that turns away from where it is steered, or accelerates away from its turn."""
    turning = channels["yaw_rate"]
    turned = turning.values - turning.values.mean()  # an offset points to no side
    for name in ("steering", "lateral_acceleration"):
        if name not in channels or len(channels[name].values) < _JUDGED_READINGS:
            continue
        other = np.interp(turning.stamps_s, *channels[name])
        other -= other.mean()
        alike = float(turned @ other) / np.sqrt((turned @ turned) * (other @ other) or 1.0)
        if alike < -_ALIKE:
            raise ValueError(
                f"yaw_rate and {name} point to opposite sides (correlation "
                f"{alike:.2g}), but both are positive to the left; give the one that is "
                f"positive to the right scale = -1.0"
            )


EQUATOR_M = 6378137.0
FLATTENING = 1 / 298.257223563


def east_north(
    latitude_rad: np.ndarray, longitude_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """East and north (n,) in m of the first of fixes (n,), on the plane that touches WGS 84 there.

    Fixes are taken to lie on the ellipsoid. A distance d from the first fix comes out too short
    by d^3 / (6 R^2), 4 mm at 10 km. A road at height h above the ellipsoid comes out shorter by
    h / R, 16 mm in 100 m at 1 km.

    Source: National Imagery and Mapping Agency TR8350.2 (2000), WGS 84:
    ellipsoid, and equation 4-14 for Cartesian coordinates, which are turned to east and north.
    """
    square = FLATTENING * (2 - FLATTENING)
    across = EQUATOR_M / np.sqrt(1 - square * np.sin(latitude_rad) ** 2)
    apart = longitude_rad - longitude_rad[:1]
    outward = across * np.cos(latitude_rad) * np.cos(apart)
    east = across * np.cos(latitude_rad) * np.sin(apart)
    axial = (1 - square) * across * np.sin(latitude_rad)
    sine, cosine = np.sin(latitude_rad[:1]), np.cos(latitude_rad[:1])
    return east, cosine * (axial - axial[:1]) - sine * (outward - outward[:1])


T = TypeVar("T")

DRIVE, COLUMNS, CAR = "drive.csv", "columns.toml", "car.toml"

POSITION_CHANNELS = ("position_x", "position_y")
_FIXES = ("latitude", "longitude")
_CHANNELS: dict[str, str] = dict(
    zip(("steering_wheel", *_FIXES), ("steering", *POSITION_CHANNELS), strict=True)
)
"""Channel of a column that is read as another quantity."""
_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


class ColumnMap(LogMap, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which column is what; ISO 8855 axes (left is positive).

    Steering is the road wheels' or the steering wheel's, whose angle the car's ratio divides. Speed
    is the car's own, or the mean of the rear wheels'. Ground speed and course are those of a
    satellite receiver; the course counts from any direction, to the left. A position is latitude
    and longitude, or x and y of a plane seen from above, x to the right and y up the page. Beside a
    position the course counts from x, which is east where latitude and longitude are logged.
    """

    si_units: ClassVar[Mapping[str, str]] = {
        "yaw_rate": "rad/s",
        **dict.fromkeys(("steering", "steering_wheel", "side_slip", "course", *_FIXES), "rad"),
        **dict.fromkeys(("speed", "ground_speed", *(f"{one}_wheel" for one in _WHEELS)), "m/s"),
        **dict.fromkeys(("lateral_acceleration", "longitudinal_acceleration"), "m/s2"),
        **dict.fromkeys(POSITION_CHANNELS, "m"),
    }
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
    ground_speed: Column | None = None
    course: Column | None = None
    latitude: Column | None = None
    longitude: Column | None = None
    position_x: Column | None = None
    position_y: Column | None = None


class LoggedDrive(NamedTuple):
    """A drive and the car that drove it."""

    drive: Drive
    car: Car


class LoggedChannels(NamedTuple):
    """Readings of a drive by the fields of `ColumnMap`, and the car that drove it.

    The steering is that of the road wheels.
    """

    channels: Mapping[str, ChannelReadings]
    car: Car


def read_folder(folder: str | Path, longest_step_s: float = math.inf) -> LoggedDrive:
    """Return the logged drive of a folder, sampled evenly.

    Args:
        folder: of the log.
        longest_step_s: as in `even_drive`.

    Raises:
        ValueError: naming file and cure, for what is missing or cannot be read.
    """
    channels, car = read_log(folder)
    return LoggedDrive(even_drive(channels, longest_step_s), car)


def read_log(folder: str | Path) -> LoggedChannels:
    """Return the readings of a folder at their own times.

    The car's own speed is also its ground speed where no other sensor tells the speed.

    Raises:
        ValueError: as `read_folder`.
    """
    folder = Path(folder)
    car = read_car(folder)
    columns = _from_toml(folder / COLUMNS, columns_from_toml)
    channels = read_channels(folder, columns.columns, columns)
    wheel = channels.pop("steering_wheel", None)
    if wheel is not None:
        on_the_road = wheel._replace(values=wheel.values / car.steering_ratio)
        channels.setdefault("steering", on_the_road)
    if _FIXES[0] in channels:
        channels |= _on_a_plane(folder, *(channels.pop(name) for name in _FIXES))
    positions = [name for name in POSITION_CHANNELS if name in channels]
    for name in ("yaw_rate", "steering", *speeds_in(channels), *positions):
        if len(channels[name].values) < 2:
            raise ValueError(
                f"{folder}: {name} has fewer than two readings, but a drive needs at least two; "
                f"look at its column in {COLUMNS}"
            )
    try:
        require_one_drive(channels)
    except ValueError as error:
        raise ValueError(f"{folder / COLUMNS}: {error}") from None
    sensed = (*free_wheels(car), "ground_speed")
    if "speed" in channels and not any(
        name in channels and len(channels[name].values) for name in sensed
    ):
        channels["ground_speed"] = channels["speed"]
    return LoggedChannels(channels, car)


def free_wheels(car: Car) -> tuple[str, str]:
    """The channels of the wheels that are not driven."""
    axle = "rear" if car.driven_axle == "front" else "front"
    return f"{axle}_left_wheel", f"{axle}_right_wheel"


def _on_a_plane(
    folder: Path, latitude: ChannelReadings, longitude: ChannelReadings
) -> dict[str, ChannelReadings]:
    """Return positions in m for fixes in rad."""
    if not np.array_equal(latitude.stamps_s, longitude.stamps_s):
        raise ValueError(
            f"{folder}: latitude has {len(latitude.values)} readings and longitude "
            f"{len(longitude.values)}, at other stamps, but a fix has both; leave both empty where "
            "one is missing"
        )
    plane = east_north(latitude.values, longitude.values)
    pairs = zip(POSITION_CHANNELS, plane, strict=True)
    return {name: latitude._replace(values=values) for name, values in pairs}


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
    text = text_of(file)
    try:
        return read(text)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def columns_from_toml(text: str) -> ColumnMap:
    """Return the map of a drive that a TOML text describes (`map_from_toml`).

    Raises:
        ValueError: as `map_from_toml`, or the map has no steering or no speed.
    """
    columns = map_from_toml(text, ColumnMap)
    if columns.steering is None and columns.steering_wheel is None:
        raise ValueError("the column map has neither steering nor steering_wheel; name a column")
    if columns.speed is None and None in (columns.rear_left_wheel, columns.rear_right_wheel):
        raise ValueError("the column map has neither speed nor both rear wheels; name columns")
    for pair in (_FIXES, POSITION_CHANNELS):
        there = [name for name in pair if getattr(columns, name) is not None]
        if len(there) == 1:
            raise ValueError(f"the column map has only {there[0]}; name {pair[0]} and {pair[1]}")
    if columns.latitude is not None and columns.position_x is not None:
        raise ValueError("the column map has latitude and position_x; name one of the two pairs")
    return columns


def logs_road_wheels(folder: str | Path) -> bool:
    """Return whether a log has the angle of the road wheels, and not that of the steering wheel.

    Raises:
        ValueError: as `read_folder`.
    """
    return _from_toml(Path(folder) / COLUMNS, columns_from_toml).steering is not None


def logged_channels(folder: str | Path) -> frozenset[str]:
    """Return the fields of `ColumnMap` that a log has a column for.

    Raises:
        ValueError: as `read_folder`.
    """
    columns = set(_from_toml(Path(folder) / COLUMNS, columns_from_toml).columns)
    return frozenset(columns | {_CHANNELS[name] for name in columns & _CHANNELS.keys()})


def delays_in(folder: str | Path) -> dict[str, float]:
    """Return the delay in s that `columns.toml` gives for each of `logged_channels`.

    Raises:
        ValueError: as `read_folder`.
    """
    columns = _from_toml(Path(folder) / COLUMNS, columns_from_toml).columns
    delays = {name: column.delay_s for name, column in columns.items()}
    return {_CHANNELS[name]: delays[name] for name in delays.keys() & _CHANNELS.keys()} | delays


def speeds_in(channels: Mapping[str, ChannelReadings]) -> tuple[str, ...]:
    """Return the names of the channels whose mean is the speed."""
    return ("speed",) if "speed" in channels else ("rear_left_wheel", "rear_right_wheel")


def even_drive(channels: Mapping[str, ChannelReadings], longest_step_s: float = math.inf) -> Drive:
    """Return channels sampled evenly; NaN where they say nothing.

    The time step is the median spacing of the fastest channel, or `longest_step_s` if that is less.

    Steering, speeds and longitudinal acceleration drive models and are interpolated. A gap of the
    channel, more than five of its own spacings, stays NaN. Yaw rate, lateral acceleration and side
    slip are what models are compared with. Each of their readings counts once, at the nearest
    instant (the mean, where an instant has several).
    """
    spacings_s = [channel.spacing_s for channel in channels.values()]
    grid = grid_over(channels, min(longest_step_s, *spacings_s))
    nothing = ChannelReadings(np.empty(0), np.empty(0))

    def driving(name: str) -> np.ndarray:
        return interpolated(channels.get(name, nothing), grid)

    def compared(name: str) -> np.ndarray:
        return mean_by_step(channels.get(name, nothing), grid)

    return Drive(
        time_step_s=grid.time_step_s,
        steering_rad=driving("steering"),
        yaw_rate_rad_s=compared("yaw_rate"),
        side_slip_rad=compared("side_slip"),
        speed_m_s=np.mean([driving(name) for name in speeds_in(channels)], axis=0),
        longitudinal_acceleration_m_s2=driving("longitudinal_acceleration"),
        lateral_acceleration_m_s2=compared("lateral_acceleration"),
        wheel_speed_m_s=np.stack([driving(f"{wheel}_wheel") for wheel in _WHEELS], axis=-1),
        heading_rad=np.full(grid.steps, np.nan),
    )


def channels_of(drive: Drive) -> dict[str, ChannelReadings]:
    """Return a drive as the readings of a log, by the fields of `ColumnMap`."""
    return {
        name: channel_of(drive.time_s, values)
        for name, (_, values) in _quantities(drive).items()
        if np.isfinite(values).any()
    }


def _quantities(drive: Drive) -> dict[str, tuple[str, np.ndarray]]:
    """Return unit and values of each column of a drive but the time."""
    return {
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


def write_drive(folder: Path, drive: Drive, car: Car) -> None:
    """Write a drive as a folder that `read_folder` reads; numbers in SI, NaN as empty fields."""
    quantities = {"time": ("s", drive.time_s), **_quantities(drive)}
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
