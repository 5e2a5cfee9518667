"""The side slip that a drive tells: channels that the fit hears, and values that it leaves."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from concord.features.vehicle.identification.slip_reference import SlipReference
from concord.features.vehicle.identification.sought import SEEN, Sought
from concord.features.vehicle.plant.parameters import Car, SensorSheet
from concord.plants.recorded.channels import ChannelReadings

_ARM = ("sensors", "accelerometer_ahead_m")
_TURNING = ("yaw_rate", "lateral_acceleration", "steering", "side_slip")
_SLIP_LATE = ("sensors", "side_slip", "delay_s")
HIDDEN = (
    _ARM,
    ("sensors", "slip_sensor_ahead_m"),
    ("front_stiffness_n_rad",),
    ("rear_stiffness_n_rad",),
    ("friction",),
    ("yaw_inertia_kg_m2",),
    ("sensors", "lateral_acceleration", "noise"),
    ("process_noise", "side_slip_rad"),
    ("process_noise", "yaw_rate_rad_s"),
)
"""Where the drive does not tell the side slip, these take each other's errors, at a NIS of 1."""
STEADY = (
    *HIDDEN,
    *(("sensors", name, "offset") for name in _TURNING),
    ("sensors", "lateral_acceleration_scale"),
    _SLIP_LATE,
)
"""These take errors of the tyres as well, where a drive is a row of steady states. A delay is an
offset there: the side slip of a steady ramp grows evenly."""
SMALL = 0.1
"""Of an error of the reference: noise that is found grows with the square of a whole one."""
_TELLING = ("side_slip", "course")
_LATE = ("sensors", "lateral_acceleration", "delay_s")


class Heard(NamedTuple):
    """Readings by the fields of `drive_log.ColumnMap`, the car of the fit, and what it seeks.

    `reference_rad` is the standard deviation of a reference that stands for the side slip, and
    `modes_rad` (modes, readings) are its errors, as in `SlipReference`.
    """

    channels: Mapping[str, ChannelReadings]
    car: Car
    sought: tuple[Sought, ...]
    reference_rad: float | None = None
    modes_rad: np.ndarray | None = None

    def with_errors(self) -> Iterator[Mapping[str, ChannelReadings]]:
        """The readings, then with `SMALL` of each error of a reference; nothing without one."""
        if self.modes_rad is None:
            return
        read = self.channels["side_slip"]
        for mode in (0.0, *(SMALL * self.modes_rad)):
            yield {**self.channels, "side_slip": read._replace(values=read.values + mode)}


def tells_slip(channels: Mapping[str, ChannelReadings], reference: SlipReference | None) -> bool:
    """Whether the drive tells its side slip, and the tyres by it.

    A reference decides where there is one, also beside a slip sensor (`slip_reference`): a drive
    too slow for it shows one steady state after another, and nothing of how the errors of the tyres
    move.
    """
    if reference is None:
        return any(is_logged(channels, name) for name in _TELLING)
    return reference.told <= SEEN


def is_logged(channels: Mapping[str, ChannelReadings], name: str) -> bool:
    """Whether a log has readings of a channel."""
    return name in channels and len(channels[name].values) > 0


def left_to_file(
    channels: Mapping[str, ChannelReadings], reference: SlipReference | None
) -> tuple[tuple[str, ...], ...]:
    """The paths of values that a drive does not tell from errors of the tyres."""
    if tells_slip(channels, reference):
        return ()
    return HIDDEN if reference is None else STEADY


def as_heard(heard: Heard, reference: SlipReference | None) -> Heard:
    """Return the same with what the drive lets seek, and the reference for a slip not logged."""
    if left := left_to_file(heard.channels, reference):
        return heard._replace(sought=tuple(one for one in heard.sought if one.path not in left))
    if reference is None or is_logged(heard.channels, "side_slip"):
        return heard
    return _with_reference(heard, reference)


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
    car = replace(heard.car, sensors=sensors)
    return Heard(channels, car, sought, noise, reference.modes_rad)
