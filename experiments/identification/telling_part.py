"""The part of a long drive that tells most: a fit takes seconds for each second of it."""

from collections.abc import Mapping

import numpy as np

from concord.plants.recorded.channels import ChannelReadings, readings_between
from concord.plants.vehicle.drive_log import speeds_in


def telling_part(
    channels: Mapping[str, ChannelReadings], longest_s: float
) -> tuple[Mapping[str, ChannelReadings], float]:
    """The channels in the `longest_s` in which the car corners most, and when these begin, in s
    from the first yaw rate; all of them in a shorter drive."""
    turning = channels["yaw_rate"]
    stamps_s = turning.stamps_s
    if stamps_s[-1] - stamps_s[0] <= longest_s:
        return channels, 0.0
    speeds = [channels[name] for name in speeds_in(channels)]
    speed = np.mean([np.interp(stamps_s, one.stamps_s, one.values) for one in speeds], axis=0)
    # Of readings that come evenly, which those of a yaw rate do.
    cornering = np.concatenate([[0.0], np.cumsum(np.square(turning.values * speed))])
    ends = np.searchsorted(stamps_s, stamps_s + longest_s, side="right")
    start_s = stamps_s[np.argmax(cornering[ends] - cornering[:-1])]
    return readings_between(channels, start_s, start_s + longest_s), float(start_s - stamps_s[0])
