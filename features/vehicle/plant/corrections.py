"""Corrections of logged readings: delays of sensors, and the place of the slip sensor."""

from collections.abc import Mapping

import numpy as np

from concord.features.vehicle.plant.drive_log import POSITION_CHANNELS, free_wheels
from concord.features.vehicle.plant.network import SENSORS_OF_NODES
from concord.features.vehicle.plant.parameters import Car, SensorSheets
from concord.plants.recorded.channels import ChannelReadings, SamplingInstants, grid_over

SMOOTHED = 20
"""Half of the window of the smoothing, in samples."""


def channels_of_nodes(car: Car) -> tuple[tuple[str, ...], ...]:
    """Return the channel of a log for each of `SENSORS_OF_NODES`; wheels are not driven."""
    satellites = ("ground_speed", "course", *POSITION_CHANNELS)
    return free_wheels(car), *SENSORS_OF_NODES[1:-1], satellites


def corrected(
    channels: Mapping[str, ChannelReadings], sheets: SensorSheets
) -> dict[str, ChannelReadings]:
    """Channels stamped without the delays of sensors, and the side slip at the centre of mass."""
    found = stamped(channels, sheets)
    if "side_slip" in found:
        found["side_slip"] = _slip_at_centre(found, sheets)
    return found


def with_true_wheels(
    channels: Mapping[str, ChannelReadings], sheets: SensorSheets
) -> dict[str, ChannelReadings]:
    """Channels with wheel speeds over their scale."""
    scale = sheets.wheel_speed_scale
    return {
        name: one._replace(values=one.values / scale) if name.endswith("_wheel") else one
        for name, one in channels.items()
    }


def stamped(
    channels: Mapping[str, ChannelReadings], sheets: SensorSheets
) -> dict[str, ChannelReadings]:
    """Channels stamped without the delays of sensors."""
    found = {}
    for name, readings in channels.items():
        sensor = "wheel_speed" if name.endswith("_wheel") else name
        sensor = "position" if name in POSITION_CHANNELS else sensor
        sheet = getattr(sheets, sensor, None)
        delay_s = 0.0 if sheet is None else sheet.delay_s
        found[name] = (
            readings._replace(stamps_s=readings.stamps_s - delay_s) if delay_s else readings
        )
    return found


def steps_over(channels: Mapping[str, ChannelReadings], time_step_s: float) -> SamplingInstants:
    """Return the steps of a run on stamped channels.

    They count from the steering, as delays do: the delay of a sensor moves no reading of another.
    """
    return grid_over(channels, time_step_s, "steering")


def _slip_at_centre(
    channels: Mapping[str, ChannelReadings], sheets: SensorSheets
) -> ChannelReadings:
    slip, ahead = channels["side_slip"], sheets.slip_sensor_ahead_m
    read = slip.values - sheets.side_slip.offset
    if not ahead:
        return slip._replace(values=read)
    turning, channels = channels["yaw_rate"], with_true_wheels(channels, sheets)
    speeds = [one for name, one in channels.items() if name == "speed" or name.endswith("_wheel")]
    yaw_rate = np.interp(slip.stamps_s, turning.stamps_s, turning.values - sheets.yaw_rate.offset)
    each = [np.interp(slip.stamps_s, one.stamps_s, one.values) for one in speeds if len(one.values)]
    speed = np.maximum(np.mean(each, axis=0), 1.0)
    return slip._replace(values=np.arctan(np.tan(read) - ahead * yaw_rate / speed))


def earlier_by(values: np.ndarray, samples: int) -> np.ndarray:
    """Readings (steps,) moved to so many samples before; NaN where none comes."""
    source = np.arange(len(values)) + samples
    there = (source >= 0) & (source < len(values))
    return np.where(there, values.take(source, mode="clip"), np.nan)


def earlier(values: np.ndarray, samples: float) -> np.ndarray:
    """Readings (steps,) as if so many samples before; NaN where none comes.

    Readings move by whole samples. For the rest a smooth curve through them is moved, so that the
    noise of each stays as it is. The curve is a parabola over `SMOOTHED` samples to either side
    (Savitzky and Golay, 1964). Readings that are NaN lie on the line between their neighbours.
    """
    whole = round(samples)
    known, steps = np.isfinite(values), np.arange(len(values))
    moved = earlier_by(values, whole)
    if known.sum() <= 2 * SMOOTHED:
        return moved
    filled = np.interp(steps, steps[known], values[known])
    weights = np.linalg.pinv(np.vander(np.arange(-SMOOTHED, SMOOTHED + 1), 3))[-1]
    padded = np.pad(filled, SMOOTHED, mode="reflect", reflect_type="odd")
    smooth = np.convolve(padded, weights, mode="valid")
    return (
        moved + np.interp(steps + samples, steps, smooth) - np.interp(steps + whole, steps, smooth)
    )
