"""Errors that last mislead the likelihood of innovations, and not output error."""

import numpy as np
import pytest
from msgspec.structs import replace

from concord.features.vehicle.identification.fit import CarFit, fit
from concord.features.vehicle.identification.logged_readings import logged_readings
from concord.features.vehicle.identification.output_error import by_output_error
from concord.features.vehicle.identification.sought import sought_of, value_at
from concord.features.vehicle.plant.drive_log import channels_of
from concord.features.vehicle.plant.model import tanh_tyre
from concord.plants.recorded.channels import ChannelReadings
from tests.features.vehicle.identification.simulated_log import FILE, TRUE, simulated_log

pytestmark = pytest.mark.slow
LASTING_S = 0.4


def test_output_error_finds_what_is_no_noise():
    channels = channels_of(simulated_log(TRUE, 8.0, 3)[0])
    every = sought_of(channels, FILE, friction=False, ratio=False)
    log = logged_readings(channels, FILE, 0.005, 3.0)
    found = by_output_error(log, tanh_tyre, every)
    for one, spreads, std in zip(every, found.spreads, found.std, strict=True):
        if one.is_noise:
            assert spreads == 0.0 and np.isinf(std), one.name
        elif np.isfinite(std):
            truth = value_at(TRUE, one.path)
            low, high = (one.value(value_at(FILE, one.path), spreads + by * std) for by in (-4, 4))
            assert low <= truth <= high, (one.name, low, high)
    seen = [one.name for one, std in zip(every, found.std, strict=True) if np.isfinite(std)]
    assert {"front stiffness", "slip sensor ahead of the centre", "delay of inertial unit"} <= set(
        seen
    )


def lasting(read: ChannelReadings, std: float, seed: int) -> ChannelReadings:
    """Readings of a sensor whose error lasts, in the place of one whose error is white."""
    generator, error = np.random.default_rng(seed), np.zeros(len(read.values))
    kept = np.exp(-read.spacing_s / LASTING_S)
    for k in range(1, len(error)):
        error[k] = kept * error[k - 1] + std * np.sqrt(1 - kept**2) * generator.standard_normal()
    return read._replace(values=read.values + error)


def fitted(channels: dict[str, ChannelReadings]) -> CarFit:
    return fit(
        channels, FILE, tanh_tyre, friction=False, ratio=False, time_step_s=0.005, min_speed_m_s=3.0
    )


@pytest.mark.study
def test_where_errors_last_the_outputs_tell_the_car():
    exact = replace(
        TRUE,
        sensors=replace(
            TRUE.sensors,
            side_slip=replace(TRUE.sensors.side_slip, noise=1e-4),
            yaw_rate=replace(TRUE.sensors.yaw_rate, noise=1e-4),
        ),
    )
    channels = channels_of(simulated_log(exact, 8.0, 3)[0])
    channels["side_slip"] = lasting(channels["side_slip"], 0.004, 1)
    channels["yaw_rate"] = lasting(channels["yaw_rate"], 0.02, 2)
    found = fitted(channels)
    assert {"front stiffness", "rear stiffness"} <= {one.name for one in found.far}
    seen = [one for one in found.found if one.seen and not one.sought.is_noise]
    assert len(seen) >= 8
    for one in seen:
        assert one.low <= value_at(TRUE, one.sought.path) <= one.high, one.sought.name


@pytest.mark.study
def test_where_the_model_is_right_both_agree():
    assert not fitted(channels_of(simulated_log(TRUE, 5.0, 3)[0])).far
