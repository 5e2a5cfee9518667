"""The belief with which filters of a logged drive start: from its first readings."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.corrections import with_true_wheels
from concord.features.vehicle.plant.drive_log import POSITION_CHANNELS, speeds_in
from concord.features.vehicle.plant.network import (
    HEADING,
    PRIOR_STD,
    SPEED,
    STATE_NAMES,
    STEERING,
    YAW_RATE,
)
from concord.features.vehicle.plant.parameters import SensorSheets
from concord.plants.range_bearing import wrapped
from concord.plants.recorded.channels import ChannelReadings

NOISES_APART = 20.0
"""Between two positions that tell a direction, in standard deviations of a position."""
UNSURE_RAD = 0.2
"""How much a car may turn between two such positions."""
TURNED_RAD = 0.8
"""A course that differs more from the way of the positions counts from elsewhere."""


class FirstBelief(NamedTuple):
    """Mean (n,) and standard deviations (n,) of the state at the first instant."""

    mean: np.ndarray
    std: np.ndarray


def start_of(channels: Mapping[str, ChannelReadings], sheets: SensorSheets) -> FirstBelief:
    """Return what the first readings tell; 0 for what they do not, with the spread `PRIOR_STD`.

    Where positions are logged, the state has them too, and the heading is that of the first
    `NOISES_APART` if no course is logged.

    Raises:
        ValueError: the course does not count from the x axis of the positions.
    """
    mean, std = np.zeros(len(STATE_NAMES)), np.array(PRIOR_STD)
    channels = with_true_wheels(channels, sheets)
    told = {
        YAW_RATE: ("yaw_rate",),
        SPEED: speeds_in(channels),
        HEADING: ("course",),
        STEERING: ("steering",),
    }
    for state, names in told.items():
        first = [channels[n].values[0] for n in names if n in channels and len(channels[n].values)]
        mean[state] = np.mean(first) if first else 0.0
    if any(name not in channels for name in POSITION_CHANNELS):
        return FirstBelief(mean, std)
    noise_m = sheets.position.noise
    way_rad, apart_m = _first_way(channels, noise_m)
    if "course" not in channels:
        mean[HEADING], std[HEADING] = way_rad, np.hypot(UNSURE_RAD, 2 * noise_m / apart_m)
    elif apart_m >= NOISES_APART * noise_m:
        _check_course(channels["course"], way_rad)
    since_s = min(one.stamps_s[0] for one in channels.values() if len(one.values))
    place, spread = np.empty(2), np.empty(2)
    along = mean[SPEED] * np.array([np.cos(mean[HEADING]), np.sin(mean[HEADING])])
    for axis, name in enumerate(POSITION_CHANNELS):
        later_s = channels[name].stamps_s[0] - since_s
        place[axis] = channels[name].values[0] - later_s * along[axis]
        spread[axis] = np.hypot(3 * noise_m, 2 * std[HEADING] * later_s * mean[SPEED])
    return FirstBelief(np.append(mean, place), np.append(std, spread))


def _first_way(channels: Mapping[str, ChannelReadings], noise_m: float) -> tuple[float, float]:
    """Direction in rad to the first position that is far enough from the first, and how far."""
    x, y = (channels[name] for name in POSITION_CHANNELS)
    east, north = x.values - x.values[0], np.interp(x.stamps_s, *y) - y.values[0]
    apart = np.hypot(east, north)
    far = apart >= NOISES_APART * noise_m
    place = int(np.argmax(far)) if far.any() else int(np.argmax(apart))
    return float(np.arctan2(north[place], east[place])), max(float(apart[place]), noise_m)


def _check_course(course: ChannelReadings, way_rad: float) -> None:
    off = float(wrapped(np.array(way_rad - course.values[0])))
    if abs(off) > TURNED_RAD:
        raise ValueError(
            f"the course is {course.values[0]:.3g} rad where the positions lead to {way_rad:.3g} "
            "rad, but it counts from the x axis (east) to the left; a compass course needs "
            "scale = -1.0 and offset = 1.5708 in columns.toml"
        )
