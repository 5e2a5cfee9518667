"""`concord identify`: tyres, sensors and process noise of a car from a drive."""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from concord.experiments.identification.fit import CarFit, FoundParameter, fit
from concord.experiments.identification.slip_reference import slip_reference
from concord.experiments.identification.sought import value_at
from concord.experiments.identification.without_slip import HIDDEN, tells_slip
from concord.experiments.places import make_folder
from concord.experiments.results.innovations.channel_test import nis_interval
from concord.experiments.user_errors import user_errors
from concord.plants.recorded.channels import ChannelReadings
from concord.plants.vehicle.corrections import with_true_wheels
from concord.plants.vehicle.drive import Drive
from concord.plants.vehicle.drive_log import (
    CAR,
    COLUMNS,
    DRIVE,
    channels_of,
    even_drive,
    logs_road_wheels,
    read_log,
    write_drive,
)
from concord.plants.vehicle.manoeuvres import MANOEUVRES
from concord.plants.vehicle.model import linear_tyre, tanh_tyre
from concord.plants.vehicle.parameters import Car, car_to_toml
from concord.plants.vehicle.sensors import TEST_CAR, logged
from concord.plants.vehicle.truth import TRUE_CARS, data_sheet, simulate
from concord.plants.vehicle.tyre_identification import MODEL_STEP_S, Identified, identify
from concord.runtime.disk import writing
from concord.scenarios.definitions.vehicle_network import TIME_STEP_S
from concord.topology.names import unknown_name

_TYRES = {"linear": linear_tyre, "saturating": tanh_tyre}
_SIMULATED_STEP_S = 0.01
_GROWN = 10.0
"""A noise that is found so many times as large as in the file may hide an error of another kind."""


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
    min_speed: float = 5.0
    """Slower parts of the drive do not count, in m/s."""
    friction: bool = False
    """Seek the friction too; only a drive near the limit tells it."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Write the car with what was found as TOML. The file must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""


class ParameterFigures(msgspec.Struct, frozen=True):
    """A parameter in the file and as found, with its interval of 95 %, None if it was not seen.

    A noise that is not seen is below `high`; all else that is not seen stays as it was.
    """

    name: str
    unit: str
    before: float
    found: float
    low: float | None
    high: float | None
    seen: bool


class Findings(msgspec.Struct, frozen=True):
    """Printed result; standard errors assume white residuals, unlike those of a drive.

    `nis_before` and `nis_after` are those of the filter that hears everything, 1 if all is right.
    Without a logged side slip the fit hears a reference, which is uncertain by
    `side_slip_reference_rad`, None where there is none. It alone tells `told_by_reference`.
    `side_slip_anees` is that of the filter that hears no side slip, with the process noise that was
    found; the written car has `side_slip_factor` times as much, and its other sensors the NIS
    `nis_written`.
    """

    car: str
    front_stiffness_n_rad: float
    front_std_n_rad: float
    rear_stiffness_n_rad: float
    rear_std_n_rad: float
    friction: float
    friction_std: float | None
    steering_offset_rad: float
    yaw_rate_rms_rad_s: float
    lateral_acceleration_rms_m_s2: float | None
    side_slip_rms_rad: float | None
    condition: float
    parameters: list[ParameterFigures]
    nis_before: float | None
    nis_after: float | None
    nis_interval: tuple[float, float] | None
    converged: bool
    side_slip_reference_rad: float | None
    told_by_reference: list[str]
    side_slip_anees: float | None
    side_slip_factor: float | None
    nis_written: float | None


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
        given = _drive(options)
        found = identify(
            given.drive,
            given.car,
            _TYRES[options.tyre],
            seek_friction=options.friction,
            min_speed_m_s=options.min_speed,
        )
        fitted = _everything(options, given, found) if options.seek == "everything" else None
    if fitted is not None:
        found = found._replace(car=fitted.car)
    if options.out is not None:
        with writing(options.out):
            options.out.write_text(car_to_toml(found.car), encoding="utf-8")
    findings = _findings(found, given.car, fitted)
    if options.json:
        sys.stdout.write(msgspec.json.encode(findings).decode() + "\n")
        return
    console = Console()
    console.print(_table(findings, given))
    for line in _in_words(findings):
        console.print(line, highlight=False)


def _everything(options: IdentifyOptions, given: "_Given", tyres: Identified) -> CarFit:
    reference = slip_reference(given.channels, tyres, _TYRES[options.tyre])
    return fit(
        given.channels,
        tyres.car if tells_slip(given.channels, reference) else given.car,
        _TYRES[options.tyre],
        friction=options.friction,
        ratio=options.data is not None and not logs_road_wheels(options.data),
        time_step_s=TIME_STEP_S,
        min_speed_m_s=options.min_speed,
        reference=reference,
        on_step=lambda: _say("."),
    )


def _say(sign: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(sign)
        sys.stderr.flush()


class _Given(NamedTuple):
    """A drive sampled evenly, its readings at their own times, and the car of the file."""

    drive: Drive
    channels: Mapping[str, ChannelReadings]
    car: Car


def _read(folder: Path) -> _Given:
    channels, car = read_log(folder)
    true = with_true_wheels(channels, car.sensors)
    return _Given(even_drive(true, MODEL_STEP_S), channels, car)


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
        return _read(options.data)
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
    return _read(options.log)


def _require_new(option: str, path: Path) -> None:
    """Refuse a path that is taken, or below a file; make the folders above it."""
    if path.exists():
        raise ValueError(f"{option} {path}: there is something of that name; choose another")
    make_folder(path.parent, option, path)


def _findings(found: Identified, before: Car, fitted: CarFit | None) -> Findings:
    yaw_rate, acceleration, side_slip = found.residual_rms
    front_std, rear_std = found.stiffness_std_n_rad
    claim = None if fitted is None else fitted.claim
    return Findings(
        car=found.car.name,
        front_stiffness_n_rad=found.car.front_stiffness_n_rad,
        front_std_n_rad=float(front_std),
        rear_stiffness_n_rad=found.car.rear_stiffness_n_rad,
        rear_std_n_rad=float(rear_std),
        friction=found.car.friction,
        friction_std=_known(found.friction_std),
        steering_offset_rad=found.steering_offset_rad,
        yaw_rate_rms_rad_s=float(yaw_rate),
        lateral_acceleration_rms_m_s2=_known(acceleration),
        side_slip_rms_rad=_known(side_slip),
        condition=found.condition,
        parameters=[] if fitted is None else [_parameter(one, before) for one in fitted.found],
        nis_before=None if fitted is None else fitted.nis_before,
        nis_after=None if fitted is None else fitted.nis_after,
        nis_interval=None if fitted is None else _nis_interval(fitted),
        converged=fitted is None or fitted.converged,
        side_slip_reference_rad=None if fitted is None else fitted.reference_rad,
        told_by_reference=[] if fitted is None else _told_by_reference(fitted),
        side_slip_anees=None if claim is None else claim.anees.value,
        side_slip_factor=None if claim is None else claim.factor,
        nis_written=None if claim is None else claim.nis,
    )


def _told_by_reference(fitted: CarFit) -> list[str]:
    if fitted.reference_rad is None:
        return []
    return [one.sought.name for one in fitted.found if one.seen and one.sought.path in HIDDEN]


def _nis_interval(fitted: CarFit) -> tuple[float, float]:
    found = nis_interval(fitted.nis_after * fitted.freedoms, fitted.freedoms)
    return found.low, found.high


def _parameter(found: FoundParameter, before: Car) -> ParameterFigures:
    return ParameterFigures(
        name=found.sought.name,
        unit=found.sought.unit,
        before=value_at(before, found.sought.path),
        found=found.value,
        low=_known(found.low),
        high=_known(found.high),
        seen=found.seen,
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _table(findings: Findings, logged: _Given) -> Table:
    drive, f = logged.drive, findings
    white = not findings.parameters
    table = Table(
        "quantity",
        "found",
        "± (white residuals)" if white else "95 % interval",
        "before",
        title=f"{findings.car}: {drive.steps} samples of {1e3 * drive.time_step_s:.4g} ms",
        title_justify="left",
    )
    for one in findings.parameters:
        name = f"{one.name}, {one.unit}" if one.unit else one.name
        table.add_row(name, f"{one.found:.4g}", _interval(one), f"{one.before:.4g}")
    if white:
        _add_tyres(table, findings, logged.car)
    table.add_section()
    for name, value in (
        ("left over of yaw rate, RMS, rad/s", f.yaw_rate_rms_rad_s),
        ("left over of lateral acceleration, m/s²", f.lateral_acceleration_rms_m_s2),
        ("left over of side slip, rad", f.side_slip_rms_rad),
    ):
        table.add_row(name, "not logged" if value is None else f"{value:.4g}", "", "")
    table.add_row("condition number", f"{f.condition:.0f}", "", "")
    return table


def _add_tyres(table: Table, f: Findings, car: Car) -> None:
    rows = (
        ("front", f.front_stiffness_n_rad, f.front_std_n_rad, car.front_stiffness_n_rad),
        ("rear", f.rear_stiffness_n_rad, f.rear_std_n_rad, car.rear_stiffness_n_rad),
    )
    for axle, found, std, before in rows:
        table.add_row(f"{axle} stiffness, N/rad", f"{found:.0f}", f"{std:.0f}", f"{before:.0f}")
    friction_std = "not sought" if f.friction_std is None else f"{f.friction_std:.3f}"
    table.add_row("friction", f"{f.friction:.3f}", friction_std, f"{car.friction:.3f}")
    table.add_row("steering offset, rad", f"{f.steering_offset_rad:.5f}", "", "")


def _interval(one: ParameterFigures) -> str:
    if one.high is None:
        return "not seen"
    return f"{one.low:.4g} to {one.high:.4g}" if one.seen else f"below {one.high:.4g}"


def _in_words(f: Findings) -> Iterator[str]:
    """Name the parameters that the drive did not show, and NIS before and after."""
    if f.nis_interval is None:
        return
    unseen = [one.name for one in f.parameters if one.high is None]
    if unseen:
        yield f"Not seen in this drive, left as they were: {', '.join(unseen)}."
    small = [one.name for one in f.parameters if one.high is not None and not one.seen]
    if small:
        yield f"Too small to see, below a bound: {', '.join(small)}."
    yield from _of_side_slip(f)
    for one in f.parameters:
        if one.name.startswith("noise of ") and one.seen and one.found >= _GROWN * one.before:
            yield (
                f"The {one.name} is {one.found / one.before:.2g} times that of the file. It may "
                "hold an error that is no noise: a unit or scale in columns.toml, a wrong stamp, a "
                "sensor that fails at times. A NIS near 1 does not rule that out."
            )
    low, high = f.nis_interval
    heard = "everything" if f.side_slip_reference_rad is None else "that side slip too"
    yield (
        f"NIS of the filter that hears {heard}: {f.nis_before:.3g} before, {f.nis_after:.3g} "
        f"after (95 %: {low:.3g} to {high:.3g}), where 1 is right."
    )
    if not f.converged:
        yield "The fit ran out of steps: identify again from the car that --out writes."


def _of_side_slip(f: Findings) -> Iterator[str]:
    """Say what told the side slip, and what its errors ask of the process noise."""
    if f.side_slip_reference_rad is not None:
        yield (
            "No side slip is logged. The fit took the one to which yaw rate and lateral "
            f"acceleration add up, within {1e3 * f.side_slip_reference_rad:.2g} mrad. Only "
            f"this side slip tells: {', '.join(f.told_by_reference)}. Their intervals assume a "
            "rigid body, with the accelerometer within 0.2 m of its place in the file; elsewhere "
            "they miss."
        )
    if f.side_slip_anees is None:
        yield (
            "This drive does not tell the side slip, nor how far the tyres err: its ANEES may be "
            "far from 1. Log the side slip, or drive a serpentine."
        )
        return
    if any(one.name == "rear stiffness" and not one.seen for one in f.parameters):
        yield (
            "This drive changes its side slip too slowly to tell the tyres, or how their errors "
            "move. Drive a serpentine."
        )
    if f.side_slip_factor is not None and f.side_slip_factor > 1:
        yield (
            f"The car has {f.side_slip_factor:.2g} times the process noise of side slip that was "
            "found: errors of the tyres last longer than a step, and other drives have others. "
            f"ANEES of the side slip was {f.side_slip_anees:.3g}; NIS is now {f.nis_written:.3g}."
        )
