"""The part of a long drive that is fitted."""

import numpy as np
import pytest

from concord.features.vehicle.identify_command import telling_part
from concord.plants.recorded.channels import ChannelReadings

STAMPS_S = 100.0 + 0.02 * np.arange(10_000)


def log(curve_s: float) -> dict[str, ChannelReadings]:
    """200 s at an even speed, straight but for five seconds."""
    since_s = STAMPS_S - STAMPS_S[0]
    yaw_rate = 0.01 + 0.3 * ((since_s >= curve_s) & (since_s < curve_s + 5))
    speed = ChannelReadings(STAMPS_S[::5], np.full(2000, 15.0))
    steering = ChannelReadings(STAMPS_S, 0.1 * yaw_rate)
    return {"yaw_rate": ChannelReadings(STAMPS_S, yaw_rate), "steering": steering, "speed": speed}


@pytest.mark.parametrize("curve_s", [0.0, 77.0, 194.0])
def test_it_holds_the_curve_and_is_as_long_as_asked(curve_s: float):
    part, start_s = telling_part(log(curve_s), 20.0)
    stamps_s = part["yaw_rate"].stamps_s
    assert (part["yaw_rate"].values > 0.2).sum() == 250
    assert stamps_s[0] - STAMPS_S[0] == pytest.approx(start_s, abs=0.021)
    assert stamps_s[-1] - stamps_s[0] <= 20.0
    turning, speed = (one.stamps_s[[0, -1]] for one in (part["yaw_rate"], part["speed"]))
    np.testing.assert_allclose(turning, speed, atol=0.1)


def test_a_curve_without_steering_does_not_count():
    """The steering of the log begins after its only curve."""
    given = log(5.0)
    late = given["steering"]
    given["steering"] = ChannelReadings(late.stamps_s[5000:], late.values[5000:])
    part, start_s = telling_part(given, 20.0)
    assert start_s >= 80.0
    assert part.keys() == given.keys()


def test_a_short_drive_is_taken_whole():
    whole = log(50.0)
    assert telling_part(whole, 200.0) == (whole, 0.0)
