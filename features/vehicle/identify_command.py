"""`concord identify-car`: tyres, sensors and process noise of a car from a drive."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
import tyro

from concord.disk import writing
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.features.vehicle.identification.findings import findings_of, in_words, table_of
from concord.features.vehicle.identification.fit import MOST_STEPS, CarFit, fit
from concord.features.vehicle.identification.slip_reference import slip_reference
from concord.features.vehicle.plant.corrections import corrected, with_true_wheels
from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import (
    CAR,
    COLUMNS,
    DRIVE,
    channels_of,
    even_drive,
    logs_road_wheels,
    read_log,
    write_drive,
)
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.model import linear_tyre, tanh_tyre
from concord.features.vehicle.plant.parameters import Car, car_to_toml
from concord.features.vehicle.plant.sensors import TEST_CAR, logged
from concord.features.vehicle.plant.truth import TRUE_CARS, data_sheet, simulate
from concord.features.vehicle.plant.tyre_identification import (
    LEAST_CORNERING_M_S2,
    MODEL_STEP_S,
    Identified,
    identify,
)
from concord.features.vehicle.plant.validity import SLOWEST_M_S
from concord.features.vehicle.scenario import TIME_STEP_S
from concord.plants.recorded.channels import ChannelReadings, readings_between
from concord.results.places import make_folder
from concord.studies.progress import progress
from concord.topology.names import unknown_name


def telling_part(
    channels: Mapping[str, ChannelReadings], longest_s: float
) -> tuple[Mapping[str, ChannelReadings], float]:
    """The channels in the `longest_s` in which the car corners most while steering and speed are
    known, and when these begin, in s from the first reading; all of them in a shorter drive."""
    drive = even_drive(channels)
    if drive.time_step_s * drive.steps <= longest_s:
        return channels, 0.0
    known = np.isfinite(drive.steering_rad)
    cornering = np.nan_to_num(np.square(drive.yaw_rate_rad_s * drive.speed_m_s)) * known
    sums = np.concatenate([[0.0], np.cumsum(cornering)])
    width = round(longest_s / drive.time_step_s)
    within = sums[width:] - sums[:-width]
    if not within.any():
        return channels, 0.0
    after_s = drive.time_step_s * float(within.argmax())
    start_s = min(one.stamps_s[0] for one in channels.values() if len(one.values)) + after_s
    return readings_between(channels, start_s, start_s + longest_s), after_s


_TYRES = {"linear": linear_tyre, "saturating": tanh_tyre}
_SIMULATED_STEP_S = 0.01


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Which drive, which tyre law, and where to put the car that comes of it."""

    data: Path | None = None
    """Folder with columns.toml, car.toml and the files of the log (docs/vehicle.md)."""
    manoeuvre: str | None = None
    """Instead of a log: a simulated drive, e.g. ramp-steer."""
    car: str = "bmw-320i"
    """Which car is simulated: bmw-320i, bmw-320i-soft, ford-escort or vw-vanagon."""
    log: Path | None = None
    """Write the simulated drive with the noise of a test car's sensors as such a folder, which must
    not exist, and identify from that: an example of what --data reads."""
    seed: int = 1
    """Of that noise."""
    tyre: Literal["linear", "saturating"] = "saturating"
    """Law of the lateral force: proportional to slip, or with a limit (tanh)."""
    seek: Literal["tyres", "everything"] = "everything"
    """The tyres alone, which takes seconds, or also process noise, the yaw inertia, and noise,
    offsets, delays and places of sensors."""
    min_speed: float = SLOWEST_M_S
    """Slower parts of the drive do not count, in m/s."""
    longest: float = 60.0
    """Of a longer log only so many seconds count: those in which the car corners most."""
    friction: bool = False
    """Seek the friction too; only a drive near the limit tells it."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Write the car with what was found as TOML. The file must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""


def identify_tyres(options: Annotated[IdentifyOptions, tyro.conf.arg(name="")]) -> None:
    """Find the tyres, the sensors and the process noise that explain a drive best.

    The tyres are fitted by output error: the logged steering and speed drive the single-track
    model, and the squared errors of yaw rate, lateral acceleration and, where logged, side slip are
    least. From there everything else, and the tyres again, is fitted by the likelihood of the
    innovations of the filter that `vehicle-network` runs.
    """
    with user_errors():
        for option, path in (("--out", options.out), ("--log", options.log)):
            if path is not None:
                _require_new(option, path)
        if not options.min_speed >= 0:
            raise ValueError(f"--min-speed {options.min_speed:g}: must be 0 or more, in m/s")
        if not options.longest > 0:
            raise ValueError(f"--longest {options.longest:g}: must be more than 0, in s")
        given = _drive(options)
        found = identify(
            given.drive,
            given.car,
            _TYRES[options.tyre],
            seek_friction=options.friction,
            min_speed_m_s=options.min_speed,
        )
        if options.seek == "tyres":
            _require_curves(found, options.min_speed)
        fitted = _everything(options, given, found) if options.seek == "everything" else None
    if fitted is not None:
        found = found._replace(car=fitted.car)
    if options.out is not None:
        with writing(options.out):
            options.out.write_text(car_to_toml(found.car), encoding="utf-8")
    findings = findings_of(found, given.car, fitted)
    if options.json:
        sys.stdout.write(msgspec.json.encode(findings).decode() + "\n")
        return
    console = plain_console()
    console.print(table_of(findings, given.drive, given.car))
    duration_s = given.drive.time_step_s * given.drive.steps
    for line in in_words(findings, given.start_s, duration_s):
        console.print(line)


def _everything(options: IdentifyOptions, given: "_Given", tyres: Identified) -> CarFit:
    tyre, steps = _TYRES[options.tyre], count(1)
    reference = slip_reference(given.channels, tyres, tyre)
    with progress("identify, at most", MOST_STEPS, as_json=options.json) as on_step:
        return fit(
            given.channels,
            given.car,
            tyre,
            friction=options.friction,
            ratio=options.data is not None and not logs_road_wheels(options.data),
            time_step_s=TIME_STEP_S,
            min_speed_m_s=options.min_speed,
            reference=reference,
            on_step=lambda: on_step(min(next(steps), MOST_STEPS)),
        )


def _require_curves(found: Identified, min_speed_m_s: float) -> None:
    if found.cornering_m_s2 < LEAST_CORNERING_M_S2:
        raise ValueError(
            f"--seek tyres: from {min_speed_m_s:g} m/s on the car corners with "
            f"{found.cornering_m_s2:.1f} m/s² at most, which tells nothing of the tyres; give a "
            f"drive with fast curves of {LEAST_CORNERING_M_S2:g} m/s² or more, correct the units "
            "of the log, or leave --seek out"
        )


class _Given(NamedTuple):
    """A drive sampled evenly, its readings at their own times, and the car of the file; from where
    in the log it is, in s."""

    drive: Drive
    channels: Mapping[str, ChannelReadings]
    car: Car
    start_s: float = 0.0


def _read(folder: Path, longest_s: float) -> _Given:
    channels, car = read_log(folder)
    channels, start_s = telling_part(channels, longest_s)
    true = with_true_wheels(corrected(channels, car.sensors), car.sensors)
    return _Given(even_drive(true, MODEL_STEP_S), channels, car, start_s)


def _drive(options: IdentifyOptions) -> _Given:
    if (options.data is None) == (options.manoeuvre is None):
        raise ValueError(
            f"name a drive: --data FOLDER with {DRIVE}, {COLUMNS} and {CAR}, or --manoeuvre "
            f"{', '.join(MANOEUVRES)} for a simulated one; not both"
        )
    if options.data is not None:
        if options.log is not None:
            raise ValueError(
                f"--log {options.log}: writes a simulated drive, but --data {options.data} is a "
                "log already; leave --log out, or simulate with --manoeuvre"
            )
        return _read(options.data, options.longest)
    assert options.manoeuvre is not None, "one of the two was given"
    if options.manoeuvre not in MANOEUVRES:
        raise unknown_name("manoeuvre", options.manoeuvre, MANOEUVRES)
    if options.car not in TRUE_CARS:
        raise unknown_name("car", options.car, TRUE_CARS)
    if options.seed < 0:
        raise ValueError(f"--seed {options.seed}: must be 0 or more")
    true_car = TRUE_CARS[options.car]
    drive = simulate(MANOEUVRES[options.manoeuvre], true_car, _SIMULATED_STEP_S)
    if options.log is None:
        return _Given(drive, channels_of(drive), data_sheet(true_car))
    noisy = logged(drive, TEST_CAR, np.random.default_rng(options.seed))
    options.log.mkdir(parents=True)
    write_drive(options.log, noisy, data_sheet(true_car))
    return _read(options.log, options.longest)


def _require_new(option: str, path: Path) -> None:
    """Refuse a path that is taken, or below a file; make the folders above it."""
    if path.exists():
        raise ValueError(f"{option} {path}: there is something of that name; choose another")
    make_folder(path.parent, option, path)
