"""A drive without logged side slip: the channels that the fit hears, and the values it leaves."""

from collections.abc import Mapping
from typing import NamedTuple, TypeGuard

import numpy as np
from msgspec.structs import replace

from concord.experiments.identification.slip_reference import SlipReference
from concord.experiments.identification.sought import SEEN, Sought
from concord.plants.recorded.channels import ChannelReadings
from concord.plants.vehicle.parameters import Car, SensorSheet

_ARM = ("sensors", "accelerometer_ahead_m")
_HIDDEN = (
    _ARM,
    ("front_stiffness_n_rad",),
    ("rear_stiffness_n_rad",),
    ("friction",),
    ("yaw_inertia_kg_m2",),
    ("sensors", "lateral_acceleration", "noise"),
    ("process_noise", "side_slip_rad"),
    ("process_noise", "yaw_rate_rad_s"),
)
"""Without a reference nothing tells the tyres from side slip: these would take each other's errors,
at a NIS of 1."""
_TELLING = ("side_slip", "course")
_LATE = ("sensors", "lateral_acceleration", "delay_s")
_SLIP_LATE = ("sensors", "side_slip", "delay_s")


class Heard(NamedTuple):
    """Readings by the fields of `drive_log.ColumnMap`, the car of the fit, and what it seeks.

    `reference_rad` is the standard deviation of a reference that stands for the side slip.
    """

    channels: Mapping[str, ChannelReadings]
    car: Car
    sought: tuple[Sought, ...]
    reference_rad: float | None = None


def tells_slip(channels: Mapping[str, ChannelReadings], reference: SlipReference | None) -> bool:
    """Whether a channel of the log, or the reference, tells the side slip."""
    logged = any(name in channels and len(channels[name].values) for name in _TELLING)
    return logged or _is_told(reference)


def _is_told(reference: SlipReference | None) -> TypeGuard[SlipReference]:
    return reference is not None and reference.told <= SEEN


def as_heard(heard: Heard, reference: SlipReference | None) -> Heard:
    """Return the same with the reference where no side slip is logged, and what it lets seek."""
    channels = heard.channels
    if "side_slip" in channels and len(channels["side_slip"].values):
        return heard
    if _is_told(reference):
        return _with_reference(heard, reference)
    if tells_slip(channels, None):
        return heard
    sought = tuple(one for one in heard.sought if one.path not in _HIDDEN)
    return heard._replace(sought=sought)


def _with_reference(heard: Heard, reference: SlipReference) -> Heard:
    """The reference takes the place of the accelerometer from the file, and its delay."""
    late_s = heard.car.sensors.lateral_acceleration.delay_s
    readings = reference.readings
    readings = readings._replace(stamps_s=readings.stamps_s + late_s)
    noise = float(np.sqrt(np.mean(np.square(reference.std_rad))))
    sheet = SensorSheet(noise=noise, delay_s=late_s)
    sensors = replace(heard.car.sensors, side_slip=sheet, slip_sensor_ahead_m=0.0)
    sought = tuple(
        one._replace(also=(*one.also, _SLIP_LATE)) if _LATE in (one.path, *one.also) else one
        for one in heard.sought
        if one.path != _ARM
    )
    channels = {**heard.channels, "side_slip": readings}
    return Heard(channels, replace(heard.car, sensors=sensors), sought, noise)
