"""`concord identify`: the tyre stiffness of a car from one of its drives, by least squares."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from concord.experiments.places import make_folder
from concord.experiments.user_errors import user_errors
from concord.plants.vehicle.drive_log import (
    CAR,
    COLUMNS,
    DRIVE,
    LoggedDrive,
    read_folder,
    write_drive,
)
from concord.plants.vehicle.manoeuvres import MANOEUVRES
from concord.plants.vehicle.model import linear_tyre, tanh_tyre
from concord.plants.vehicle.parameters import car_to_toml
from concord.plants.vehicle.sensors import TEST_CAR, logged
from concord.plants.vehicle.truth import TRUE_CARS, data_sheet, simulate
from concord.plants.vehicle.tyre_identification import MODEL_STEP_S, Identified, identify
from concord.runtime.disk import writing
from concord.topology.names import unknown_name

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
    friction: bool = False
    """Seek the friction too; only a drive near the limit tells it."""
    out: Path | None = None
    """Write the car with what was found as TOML. The file must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""


class Findings(msgspec.Struct, frozen=True):
    """Printed result; standard errors assume white residuals, unlike those of a drive."""

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


def identify_tyres(options: Annotated[IdentifyOptions, tyro.conf.arg(name="")]) -> None:
    """Find the cornering stiffness of both axles that explains a drive best.

    Method: output error. The logged steering and speed drive the single-track model. The fit varies
    stiffnesses, friction, and constant offsets of steering and sensors. It minimises the squared
    errors of yaw rate, lateral acceleration and, where logged, side slip.
    """
    with user_errors():
        for option, path in (("--out", options.out), ("--log", options.log)):
            if path is not None:
                _require_new(option, path)
        given = _drive(options)
        found = identify(
            given.drive, given.car, _TYRES[options.tyre], seek_friction=options.friction
        )
    if options.out is not None:
        with writing(options.out):
            options.out.write_text(car_to_toml(found.car), encoding="utf-8")
    findings = _findings(found)
    if options.json:
        sys.stdout.write(msgspec.json.encode(findings).decode() + "\n")
        return
    Console().print(_table(findings, given))


def _drive(options: IdentifyOptions) -> LoggedDrive:
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
        return read_folder(options.data, MODEL_STEP_S)
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
        return LoggedDrive(drive, data_sheet(true_car))
    noisy = logged(drive, TEST_CAR, np.random.default_rng(options.seed))
    options.log.mkdir(parents=True)
    write_drive(options.log, noisy, data_sheet(true_car))
    return read_folder(options.log, MODEL_STEP_S)


def _require_new(option: str, path: Path) -> None:
    """Refuse a path that is taken, or below a file; make the folders above it."""
    if path.exists():
        raise ValueError(f"{option} {path}: there is something of that name; choose another")
    make_folder(path.parent, option, path)


def _findings(found: Identified) -> Findings:
    yaw_rate, acceleration, side_slip = found.residual_rms
    front_std, rear_std = found.stiffness_std_n_rad
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
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _table(findings: Findings, logged: LoggedDrive) -> Table:
    drive = logged.drive
    table = Table(
        "quantity",
        "found",
        "± (white residuals)",
        "before",
        title=f"{findings.car}: {drive.steps} samples of {1e3 * drive.time_step_s:.4g} ms",
        title_justify="left",
    )
    f, car = findings, logged.car
    table.add_row(
        "front stiffness, N/rad",
        f"{f.front_stiffness_n_rad:.0f}",
        f"{f.front_std_n_rad:.0f}",
        f"{car.front_stiffness_n_rad:.0f}",
    )
    table.add_row(
        "rear stiffness, N/rad",
        f"{f.rear_stiffness_n_rad:.0f}",
        f"{f.rear_std_n_rad:.0f}",
        f"{car.rear_stiffness_n_rad:.0f}",
    )
    friction_std = "not sought" if f.friction_std is None else f"{f.friction_std:.3f}"
    table.add_row("friction", f"{f.friction:.3f}", friction_std, f"{car.friction:.3f}")
    table.add_row("steering offset, rad", f"{f.steering_offset_rad:.5f}", "", "")
    table.add_section()
    for name, value in (
        ("left over of yaw rate, RMS, rad/s", f.yaw_rate_rms_rad_s),
        ("left over of lateral acceleration, m/s²", f.lateral_acceleration_rms_m_s2),
        ("left over of side slip, rad", f.side_slip_rms_rad),
    ):
        table.add_row(name, "not logged" if value is None else f"{value:.4g}", "", "")
    table.add_row("condition number", f"{f.condition:.0f}", "", "")
    return table
