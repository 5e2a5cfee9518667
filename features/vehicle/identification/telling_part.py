"""The part of a long drive that tells most: a fit takes seconds for each second of it."""

from collections.abc import Mapping

import numpy as np

from concord.features.vehicle.plant.drive_log import even_drive
from concord.plants.recorded.channels import ChannelReadings, readings_between


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
