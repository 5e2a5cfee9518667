"""Findings of `concord identify`: figures for JSON, a table, and sentences."""

from collections.abc import Iterator

import msgspec
import numpy as np
from msgspec.structs import replace
from rich.table import Table

from concord.features.vehicle.identification.fit import CarFit, FoundParameter
from concord.features.vehicle.identification.sought import value_at
from concord.features.vehicle.identification.without_slip import HIDDEN
from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.tyre_identification import LEAST_CORNERING_M_S2, Identified
from concord.results.innovations.channel_test import nis_interval

_WHOLE_S = 0.5
"""At the ends of a drive, where not all channels have begun or some have ended."""
_GROWN = 10.0
"""A noise that is found so many times as large as in the file may hide an error of another kind."""


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
    `side_slip_anees` is that of the filter that hears no side slip. The written car has
    `side_slip_factor` times the process noise of side slip that was found,
    `lateral_acceleration_factor` times that noise, and its other sensors the NIS `nis_written`.
    If innovations and outputs disagree about `disagreeing`, all but noise is of the outputs.
    """

    car: str
    front_stiffness_n_rad: float
    front_std_n_rad: float | None
    rear_stiffness_n_rad: float
    rear_std_n_rad: float | None
    friction: float
    friction_std: float | None
    steering_offset_rad: float
    yaw_rate_rms_rad_s: float
    lateral_acceleration_rms_m_s2: float | None
    side_slip_rms_rad: float | None
    condition: float
    part_s: tuple[float, float]
    cornering_m_s2: float
    parameters: list[ParameterFigures] = []
    nis_before: float | None = None
    nis_after: float | None = None
    nis_interval: tuple[float, float] | None = None
    converged: bool = True
    side_slip_reference_rad: float | None = None
    told_by_reference: list[str] = []
    side_slip_anees: float | None = None
    side_slip_factor: float | None = None
    lateral_acceleration_factor: float | None = None
    nis_written: float | None = None
    disagreeing: list[str] = []


def findings_of(found: Identified, before: Car, fitted: CarFit | None) -> Findings:
    """The figures of the tyres, and of everything else where that was fitted."""
    yaw_rate, acceleration, side_slip = found.residual_rms
    front_std, rear_std = found.stiffness_std_n_rad
    tyres = Findings(
        car=found.car.name,
        front_stiffness_n_rad=found.car.front_stiffness_n_rad,
        front_std_n_rad=_known(front_std),
        rear_stiffness_n_rad=found.car.rear_stiffness_n_rad,
        rear_std_n_rad=_known(rear_std),
        friction=found.car.friction,
        friction_std=_known(found.friction_std),
        steering_offset_rad=found.steering_offset_rad,
        yaw_rate_rms_rad_s=float(yaw_rate),
        lateral_acceleration_rms_m_s2=_known(acceleration),
        side_slip_rms_rad=_known(side_slip),
        condition=found.condition,
        part_s=found.part_s,
        cornering_m_s2=found.cornering_m_s2,
    )
    if fitted is None:
        return tyres
    seen = [one.sought for one in fitted.found if one.seen]
    interval = nis_interval(fitted.nis_after * fitted.freedoms, fitted.freedoms)
    claim = fitted.claim
    return replace(
        tyres,
        parameters=[_parameter(one, before) for one in fitted.found],
        nis_before=fitted.nis_before,
        nis_after=fitted.nis_after,
        nis_interval=(interval.low, interval.high),
        converged=fitted.converged,
        side_slip_reference_rad=fitted.reference_rad,
        told_by_reference=[
            one.name for one in seen if fitted.reference_rad is not None and one.path in HIDDEN
        ],
        side_slip_anees=None if claim is None else claim.anees.value,
        side_slip_factor=None if claim is None else _process_factor(fitted),
        lateral_acceleration_factor=None if claim is None else claim.factor,
        nis_written=None if claim is None else claim.nis,
        disagreeing=[one.name for one in fitted.far],
    )


def _process_factor(fitted: CarFit) -> float:
    """Process noise of side slip of the written car over that which was found."""
    path = ("process_noise", "side_slip_rad")
    found = next(one.value for one in fitted.found if one.sought.path == path)
    return value_at(fitted.car, path) / found


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


def table_of(findings: Findings, drive: Drive, before: Car) -> Table:
    """The parameters of the fit, or the tyres alone, and what is left over."""
    f = findings
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
        _add_tyres(table, findings, before)
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


def in_words(f: Findings, first_s: float, duration_s: float) -> Iterator[str]:
    """Name what a drive that starts at `first_s` of its log did not show, and NIS before and
    after."""
    if first_s:
        yield (
            f"The fit took the log from {first_s:.0f} to {first_s + duration_s:.0f} s, where the "
            "car corners most; --longest takes more."
        )
    start_s, end_s = (first_s + one for one in f.part_s)
    if end_s - start_s < duration_s - _WHOLE_S:
        yield (
            f"What is left over is that of the part from {start_s:.1f} to {end_s:.1f} s: elsewhere "
            "the log has gaps in steering or speed."
        )
    if f.nis_interval is None:
        return
    if f.front_std_n_rad is None:
        yield (
            f"The car corners with {f.cornering_m_s2:.1f} m/s² at most, which tells little of the "
            f"tyres. Drive curves of {LEAST_CORNERING_M_S2:g} m/s² or more for these."
        )
    unseen = [one.name for one in f.parameters if one.high is None]
    if unseen:
        yield f"Not seen in this drive, left as they were: {', '.join(unseen)}."
    small = [one.name for one in f.parameters if one.high is not None and not one.seen]
    if small:
        yield f"Too small to see, below a bound: {', '.join(small)}."
    if f.disagreeing:
        yield (
            "Errors of the model last here: the likeliest values would be far from those with "
            f"which the car follows its steering and speed best ({', '.join(f.disagreeing)}). "
            "So all but noise is of the latter (output error)."
        )
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
            f"this side slip tells: {', '.join(f.told_by_reference)}. Their intervals assume that "
            "the body rolls 0 to 0.16 s after the acceleration, and an accelerometer within 0.2 m "
            "of its place in the file; elsewhere they miss. The noise of the car takes that place "
            "for exact: measure it."
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
    if f.side_slip_factor is not None and f.side_slip_factor > 1 + 1e-9:
        yield (
            f"The car has {f.side_slip_factor:.2g} times the process noise of side slip that was "
            f"found, and {f.lateral_acceleration_factor:.2g} times the noise of lateral "
            "acceleration, which tells it by the tyres: their errors last longer than a step, and "
            f"other drives have others. ANEES of the side slip was {f.side_slip_anees:.3g}; NIS is "
            f"now {f.nis_written:.3g}."
        )
