"""Identification takes each reading of a log once, at its own time, and knows how sure it is."""

import numpy as np
import pytest

from concord.features.vehicle.identification.fit import fit
from concord.features.vehicle.identification.likelihood import likelihood
from concord.features.vehicle.identification.logged_readings import logged_readings
from concord.features.vehicle.identification.sought import sought_of
from concord.features.vehicle.plant.corrections import channels_of_nodes
from concord.features.vehicle.plant.drive_log import channels_of
from concord.features.vehicle.plant.model import tanh_tyre
from concord.features.vehicle.plant.replay import replayed
from concord.plants.recorded.channels import ChannelReadings
from tests.features.vehicle.identification.simulated_log import TRUE, simulated_log

pytestmark = pytest.mark.slow

GNSS = {"ground_speed": 0.05, "course": 0.003}


def mixed_rates(seconds: float, seed: int) -> dict[str, ChannelReadings]:
    """A log of `TRUE`: wheels at 40 Hz, side slip in pairs of readings, satellites at 10 Hz."""
    drive, states = simulated_log(TRUE, seconds, seed)
    channels = channels_of(drive)
    for name in ("front_left_wheel", "front_right_wheel"):
        read = channels[name]
        channels[name] = ChannelReadings(read.stamps_s[3::5], read.values[3::5])
    slip = channels["side_slip"]
    stamps = slip.stamps_s.copy()
    stamps[1::2] -= 0.004
    channels["side_slip"] = slip._replace(stamps_s=stamps)
    every, generator = slice(0, None, 20), np.random.default_rng(seed)
    exact = {
        "ground_speed": states[every, 2] / np.cos(states[every, 1]),
        # Many turns: a receiver starts again at a full turn.
        "course": np.mod(3.1 + states[every, 3] + states[every, 1], 2 * np.pi),
    }
    for name, values in exact.items():
        noise = GNSS[name] * generator.standard_normal(len(values))
        channels[name] = ChannelReadings(drive.time_s[every], values + noise)
    return channels


def test_it_takes_the_readings_of_a_run():
    """Those of the plant that nodes hear, at the same steps; none is used twice, none is lost."""
    channels = mixed_rates(1.0, 2)
    log, plant = logged_readings(channels, TRUE, 0.005, 5.0), replayed(channels, TRUE, 0.005)
    names = (*sum(channels_of_nodes(TRUE), ()), "side_slip")
    for place, name in enumerate(names):
        columns = log.readings[:, np.equal(log.channels, place)]
        logged = len(channels[name].values) if name in channels else 0
        assert np.isfinite(columns).sum() == logged, name
    assert np.equal(log.channels, names.index("side_slip")).sum() == 2
    heard = np.concatenate([plant.exact[:, 0, 0, :2], plant.exact[:, 1, 0, :3]], axis=1)
    np.testing.assert_array_equal(log.readings[:, :5], heard)


@pytest.mark.study
def test_slow_sensors_keep_their_noise_and_satellites_are_fitted():
    """Wheel speeds that were interpolated had a noise of two thirds of the truth."""
    channels = mixed_rates(6.0, 4)
    found = fit(
        channels, TRUE, tanh_tyre, friction=False, ratio=False, time_step_s=0.005, min_speed_m_s=5.0
    )
    by_name = {one.sought.name: one for one in found.found}
    for sensor, truth in {"wheel speed": 0.05, **GNSS}.items():
        noise = by_name[f"noise of {sensor.replace('_', ' ')}"]
        assert noise.low < truth < noise.high, sensor
        assert noise.high < 2 * noise.low
    delay = by_name["delay of satellite receiver"]
    assert delay.low < 0.0 < delay.high


def test_scatter_of_scores_is_the_information_unless_readings_hang_together():
    """White (1982): both are one where the model is right. Repeated noise widens an interval."""
    drive, _ = simulated_log(TRUE, 10.0, 5)
    sought = tuple(
        one
        for one in sought_of(channels_of(drive), TRUE, friction=False, ratio=False)
        if one.name in ("offset of lateral acceleration", "noise of lateral acceleration")
    )
    ratios = {}
    generator = np.random.default_rng(1)
    coloured = np.convolve(generator.standard_normal(drive.steps + 9), np.ones(10), "valid")
    exact = channels_of(simulated_log(TRUE, 10.0, 5)[0])["lateral_acceleration"].values
    for name, added in (("right", 0.0), ("coloured", 0.15 * coloured / np.sqrt(10))):
        log = channels_of(drive._replace(lateral_acceleration_m_s2=exact + added))
        readings = logged_readings(log, TRUE, 0.005, 5.0)
        here = likelihood(readings, tanh_tyre, sought, np.zeros(2), np.ones(2))
        ratios[name] = np.diagonal(here.scatter) / np.diagonal(here.information)
    assert (np.abs(np.log(ratios["right"])) < np.log(2)).all(), ratios
    assert ratios["coloured"][0] > 3 * ratios["right"][0]
