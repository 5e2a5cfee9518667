"""Whether the channels of a log are one drive: by one clock, with one sense of left."""

from collections.abc import Mapping

import numpy as np

from concord.plants.recorded.channels import ChannelReadings

_LONGEST_SPACING_S = 2.0
_JUDGED_READINGS, _ALIKE = 50, 0.8
"""Readings that tell a side, at least, and a correlation that tells it."""


def require_one_drive(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse units and signs of `columns.toml` that no drive can have.

    Raises:
        ValueError: naming the channel and the cure.
    """
    _require_one_clock(channels)
    _require_one_side(channels)


def _require_one_clock(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse channels that never meet, and readings that are far apart."""
    steering = channels["steering"].stamps_s
    for name, (stamps_s, _) in channels.items():
        if len(stamps_s) and max(stamps_s[0], steering[0]) > min(stamps_s[-1], steering[-1]):
            raise ValueError(
                f"{name} was read from {stamps_s[0]:.15g} to {stamps_s[-1]:.15g} s, but "
                f"steering from {steering[0]:.15g} to {steering[-1]:.15g} s, so they never meet; "
                "correct unit and offset of their times"
            )
    if channels["steering"].spacing_s > _LONGEST_SPACING_S:
        raise ValueError(
            f"steering has a reading every {channels['steering'].spacing_s:.3g} s, but a "
            "car is steered within tenths; correct the unit of its time"
        )


def _require_one_side(channels: Mapping[str, ChannelReadings]) -> None:
    """Refuse a car that turns away from where it is steered, or accelerates away from its turn."""
    turning = channels["yaw_rate"]
    turned = turning.values - turning.values.mean()  # an offset points to no side
    for name in ("steering", "lateral_acceleration"):
        if name not in channels or len(channels[name].values) < _JUDGED_READINGS:
            continue
        other = np.interp(turning.stamps_s, *channels[name])
        other -= other.mean()
        alike = float(turned @ other) / np.sqrt((turned @ turned) * (other @ other) or 1.0)
        if alike < -_ALIKE:
            raise ValueError(
                f"yaw_rate and {name} point to opposite sides (correlation "
                f"{alike:.2g}), but both are positive to the left; give the one that is "
                f"positive to the right scale = -1.0"
            )
