"""The readings of a drive as the filters of `identification` take them, step by step."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from concord.features.vehicle.plant.corrections import channels_of_nodes, stamped, steps_over
from concord.features.vehicle.plant.drive_log import speeds_in
from concord.features.vehicle.plant.network import SENSORS_OF_NODES
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.start import FirstBelief, start_of
from concord.plants.recorded.channels import (
    ChannelReadings,
    interpolated,
    lateness_s,
    readings_by_step,
)

SENSORS = (*(name for names in SENSORS_OF_NODES for name in names), "side_slip")
"""The sensor of each channel that a filter may hear."""
COURSE = SENSORS.index("course")
ENDS_S = 0.25
"""Innovations so near to the ends do not count: delays move readings across the ends."""


@dataclass(frozen=True, eq=False)
class LoggedReadings:
    """A drive as the filter takes it.

    Attributes:
        readings: (steps, m), each at the step next to its stamp, NaN for nothing. A channel is
            there as often as a step has several readings of it.
        channels: (m,), which ones they are.
        speed_m_s: (steps,), on lines between readings.
        counted: (steps,), whether the innovations of readings count: the car is fast enough.
        start: belief at the first step, of 6 states, or of 8 where positions are logged.
        time_step_s: of a run.
        car: of the file, with the delays with which readings came to their steps. A stamp between
            two steps counts as the nearer one, so they differ from those of the file by less.
    """

    readings: np.ndarray
    channels: tuple[int, ...]
    speed_m_s: np.ndarray
    counted: np.ndarray
    start: FirstBelief
    time_step_s: float
    car: Car

    @property
    def sensors(self) -> tuple[str, ...]:
        """The sensor of each channel."""
        return tuple(SENSORS[channel] for channel in self.channels)

    @property
    def positioned(self) -> bool:
        """Whether positions are among the readings."""
        return "position" in self.sensors


def logged_readings(
    channels: Mapping[str, ChannelReadings], car: Car, time_step_s: float, min_speed_m_s: float
) -> LoggedReadings:
    """The readings of a log, each once, at the steps at which a run has them.

    The car says which wheels are not driven, and by how much the stamps of sensors are late.
    """
    channels = stamped(channels, car.sensors)
    grid = steps_over(channels, time_step_s)
    names = (*(name for names in channels_of_nodes(car) for name in names), "side_slip")
    columns, there = [], []
    late_s: dict[str, list[float]] = {}
    for place, name in enumerate(names):
        if name in channels and len(channels[name].values):
            read = channels[name]
            if place == COURSE:
                read = read._replace(values=np.unwrap(read.values))
            columns.append(readings_by_step(read, grid))
            there += [place] * columns[-1].shape[1]
            late_s.setdefault(SENSORS[place], []).append(lateness_s(channels[name], grid))
    speed = np.mean([interpolated(channels[name], grid) for name in speeds_in(channels)], axis=0)
    since_s, known = time_step_s * np.arange(grid.steps), np.isfinite(speed)
    return LoggedReadings(
        np.concatenate(columns, axis=1),
        tuple(there),
        np.interp(since_s, since_s[known], speed[known]),
        (np.nan_to_num(speed) >= min_speed_m_s)
        & (np.minimum(since_s, since_s[-1] - since_s) >= ENDS_S),
        start_of(channels, car.sensors),
        time_step_s,
        _as_read(car, {name: float(np.mean(each)) for name, each in late_s.items()}),
    )


def _as_read(car: Car, late_s: Mapping[str, float]) -> Car:
    """The car with the delays at which sensors were read, in the time of the steering."""
    zero_s, sheets = late_s.get("steering", 0.0), {}
    for name, late in late_s.items():
        sheet = getattr(car.sensors, name)
        sheets[name] = replace(sheet, delay_s=sheet.delay_s + late - zero_s)
    return replace(car, sensors=replace(car.sensors, **sheets))
