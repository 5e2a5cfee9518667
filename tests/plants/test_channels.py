"""Channels of logs: each reading is used once, in the step whose interval holds its stamp."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.vehicle.plant.corrections import steps_over
from concord.plants.recorded.channels import (
    ChannelReadings,
    SamplingInstants,
    channel_of,
    grid_over,
    interpolated,
    lateness_s,
    mean_by_step,
    readings_by_step,
)

STAMPS_US = st.lists(st.integers(0, 1_000_000), min_size=1, max_size=60, unique=True)


def numbered(stamps_us: list[int]) -> ChannelReadings:
    return channel_of(1e-6 * np.array(stamps_us), np.arange(float(len(stamps_us))))


@given(STAMPS_US, st.sampled_from([0.0051, 0.0103, 0.0507]))
def test_every_reading_is_placed_once_and_at_the_nearest_step(stamps_us, time_step_s):
    channel = numbered(stamps_us)
    grid = grid_over({"a": channel}, time_step_s)
    placed = readings_by_step(channel, grid)
    used = Counter(placed[np.isfinite(placed)].astype(int).tolist())
    assert used == Counter(range(len(stamps_us)))
    for number, stamp_us in enumerate(stamps_us):
        (step,) = np.flatnonzero((placed == number).any(axis=1))
        distance = np.abs(grid.instants_s - 1e-6 * stamp_us)
        assert distance[step] <= distance.min() + 1e-12


@given(STAMPS_US, st.randoms(use_true_random=False))
def test_the_order_of_the_lines_does_not_matter(stamps_us, random):
    order = list(range(len(stamps_us)))
    random.shuffle(order)
    channel, values = numbered(stamps_us), np.arange(float(len(stamps_us)))
    again = channel_of(1e-6 * np.array(stamps_us)[order], values[order])
    np.testing.assert_array_equal(again.stamps_s, channel.stamps_s)
    np.testing.assert_array_equal(again.values, channel.values)


def test_a_reading_is_off_by_half_a_step_of_change_at_most():
    """And by 1 / sqrt(12) of a step of change RMS, where stamps lie anywhere."""
    stamps = np.sort(np.random.default_rng(1).uniform(0, 100, 20_000))
    grid = SamplingInstants(0.0, 0.02, 5001)
    placed = readings_by_step(ChannelReadings(stamps, 3.0 * stamps), grid)
    error = (placed - 3.0 * grid.instants_s[:, None])[np.isfinite(placed)]
    assert len(error) == 20_000
    assert np.abs(error).max() <= 3.0 * 0.01 + 1e-12
    assert np.sqrt((error**2).mean()) == pytest.approx(3.0 * 0.02 / np.sqrt(12), rel=0.02)


def test_readings_of_one_step_stand_side_by_side_and_their_mean_is_one():
    channel = ChannelReadings(np.array([0.0, 0.9, 1.1, 3.0]), np.array([1.0, 2.0, 4.0, 8.0]))
    grid = grid_over({"a": channel}, 1.0)
    nan = np.nan
    placed = readings_by_step(channel, grid)
    np.testing.assert_array_equal(placed, [[1, nan], [2, 4], [nan, nan], [8, nan]])
    np.testing.assert_array_equal(mean_by_step(channel, grid), [1, 3, nan, 8])


@pytest.mark.parametrize("late_s", [0.0, 0.0012, 0.0025, 0.0173, 0.0176])
def test_the_delay_of_a_sensor_moves_no_reading_of_another(late_s: float):
    """A wheel that was 17.3 ms late put the side slip to another step of the steering: `identify`
    found a delay of 14.4 ms, and the run took it for 10 ms."""
    stamps_s = 0.005 * np.arange(40)
    every = {"steering": 0.0, "side_slip": 0.0144, "wheel_speed": late_s}
    channels = {name: ChannelReadings(stamps_s - by, stamps_s) for name, by in every.items()}
    grid = steps_over(channels, 0.005)
    steering, slip, wheel = (readings_by_step(one, grid)[:, 0] for one in channels.values())
    both = np.isfinite(steering) & np.isfinite(slip)
    np.testing.assert_allclose((slip - steering)[both], 0.015)
    as_read_s = 0.0144 + lateness_s(channels["side_slip"], grid)
    assert as_read_s == pytest.approx(0.015)
    both = np.isfinite(steering) & np.isfinite(wheel)
    assert len(set((wheel - steering)[both].round(6))) == 1, "each step has one reading"


def test_a_gap_is_judged_by_the_spacing_of_the_channel():
    grid = SamplingInstants(0.0, 0.5, 41)
    stamps = np.array([0, 1, 2, 3, 4, 5, 11, 12, 13, 18.0, 19.0])
    values = interpolated(ChannelReadings(stamps, 2.0 * stamps), grid)
    known = np.isfinite(values)
    np.testing.assert_allclose(values[known], 2.0 * grid.instants_s[known])
    missing = grid.instants_s[~known]
    # Six spacings are a gap, five are none, and nothing is known after the end.
    np.testing.assert_array_equal(missing, [*np.arange(5.5, 11, 0.5), 19.5, 20.0])


def test_an_empty_channel_says_nothing():
    grid, nothing = SamplingInstants(0.0, 0.5, 3), ChannelReadings(np.empty(0), np.empty(0))
    assert np.isnan(interpolated(nothing, grid)).all()
    assert np.isnan(mean_by_step(nothing, grid)).all()


@pytest.mark.parametrize(
    ("stamps", "values", "says"),
    [
        ([0.0, np.nan, 1.0], [1.0, 2.0, 3.0], "reading 2 has no time"),
        ([0.0, 1.0, 1.0], [1.0, 2.0, 3.0], "reading 2 and reading 3 have the time 1 s"),
    ],
)
def test_a_reading_without_a_time_of_its_own_is_refused(stamps, values, says):
    with pytest.raises(ValueError, match=says):
        channel_of(np.array(stamps), np.array(values))


def test_rows_without_a_reading_need_no_time_of_their_own():
    rows = channel_of(np.array([np.nan, 0.0, 0.0]), np.array([np.nan, 1.0, np.nan]))
    np.testing.assert_array_equal(rows.stamps_s, [0.0])


def test_channels_whose_clocks_are_hours_apart_are_refused():
    imu = ChannelReadings(np.arange(0.0, 20.0, 0.05), np.zeros(400))
    gps = ChannelReadings(7200 + np.arange(0.0, 20.0, 0.25), np.zeros(80))
    with pytest.raises(ValueError, match=r"gps begins at 7200 s, 7180.05 s after imu and all"):
        grid_over({"gps": gps, "imu": imu}, 0.05)


def test_channels_that_never_read_at_one_time_are_told(capsys: pytest.CaptureFixture[str]):
    first = ChannelReadings(np.arange(0.0, 20.0, 0.25), np.zeros(80))
    later = {
        gap_s: ChannelReadings(first.stamps_s + 19.75 + gap_s, np.zeros(80)) for gap_s in (1, 30)
    }
    # One camera after the other is a network; a minute between them may be a clock.
    assert grid_over({"a": first, "b": later[1]}, 0.25).steps == 163
    assert capsys.readouterr().err == ""
    assert grid_over({"a": first, "b": later[30]}, 0.25).steps == 279
    assert "b begins at 49.75 s, 30 s after a and all that begins before" in capsys.readouterr().err
