"""The car as a network: what its nodes believe of their sensors, and a drive replayed."""

from pathlib import Path

import numpy as np
import pytest

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import read_log, write_drive
from concord.features.vehicle.plant.model import single_track, tanh_tyre
from concord.features.vehicle.plant.network import (
    ACCELERATION,
    CHANNELS,
    ERRORS,
    HEADING,
    NODES,
    PRIOR_STD,
    SIDE_SLIP,
    SPEED,
    STEERING,
    YAW_RATE,
    DrivenCar,
    sensor,
    simulated,
)
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.features.vehicle.plant.replay import replayed
from concord.features.vehicle.plant.sensors import SensorError

BELIEVED = ((0.1, 0.1), (0.005, 1.0, 0.05), (0.0005,), (0.05, 0.003))
MODEL = single_track(BMW_320I, tanh_tyre, 0.005, np.diag([1e-5, 1e-7, 1e-7]))
CAR = DrivenCar(MODEL)
STATES = np.array([0.2, 0.03, 20.0, 0.5, 0.04, 0.3]) * np.random.default_rng(1).uniform(
    0.5, 1.5, (5, 6)
)


def model_drive(steps: int = 100, step_s: float = 0.005) -> Drive:
    """A drive of rigid wheels that roll where they point."""
    generator = np.random.default_rng(2)
    yaw_rate, side_slip = generator.normal(0, [0.2, 0.02], (steps, 2)).T
    speed = generator.uniform(15, 25, steps)
    steering, heading = generator.normal(0, [0.05, 0.5], (steps, 2)).T
    side = 0.5 * BMW_320I.front_track_m * yaw_rate
    wheels = np.empty((steps, 4))
    for wheel, way, x in ((0, -1, 1), (1, 1, 1), (2, -1, -1), (3, 1, -1)):
        side = 0.5 * (BMW_320I.front_track_m if x > 0 else BMW_320I.rear_track_m) * yaw_rate
        along = speed + way * side
        arm = BMW_320I.front_axle_m if x > 0 else -BMW_320I.rear_axle_m
        across = speed * np.tan(side_slip) + arm * yaw_rate
        angle = steering if x > 0 else 0.0
        wheels[:, wheel] = along * np.cos(angle) + across * np.sin(angle)
    states = np.stack([yaw_rate, side_slip, speed], axis=-1)
    ahead = generator.normal(0, 0.3, steps)
    return Drive(
        step_s,
        steering,
        yaw_rate,
        side_slip,
        speed,
        ahead,
        MODEL.measure(states, np.stack([steering, ahead], axis=-1))[:, 0],
        wheels,
        heading,
    )


def test_inputs_are_carried_on_and_the_heading_turns():
    moved = CAR.transition(STATES, None, 0)
    np.testing.assert_array_equal(moved[..., STEERING:], STATES[..., STEERING:])
    np.testing.assert_allclose(
        moved[..., HEADING], STATES[..., HEADING] + 0.005 * STATES[..., YAW_RATE]
    )
    for state, after in zip(STATES, moved, strict=True):
        control = state[[STEERING, ACCELERATION]]
        np.testing.assert_array_equal(after[:3], MODEL.transition(state[:3], control, 0))


@pytest.mark.parametrize("driven", ["front", "rear"])
def test_nodes_believe_what_the_sensors_deliver(driven):
    """On wheels that roll where they point, satellites included."""
    from msgspec.structs import replace

    drive, car = model_drive(), replace(BMW_320I, driven_axle=driven)
    model = single_track(car, tanh_tyre, 0.005, MODEL.noise_cov)
    felt = model.measure(drive.states, drive.inputs)[:, 0]
    drive = drive._replace(lateral_acceleration_m_s2=felt)
    plant = simulated(drive, car)
    for node in range(len(NODES)):
        own = sensor(node, model)
        value, noise_cov = own.interpret(plant.exact[:, node, 0])
        taken = np.isfinite(value).all(axis=-1)
        assert taken.any()
        predicted = own.measure(plant.truth, 0)
        left = own.residual(value, predicted)[taken]
        np.testing.assert_allclose(left, 0.0, atol=1e-9)
        np.testing.assert_allclose(noise_cov[0], np.diag(np.square(BELIEVED[node])))
        batch = own.measure(np.broadcast_to(STATES, (13, 5, 6)), 0)
        np.testing.assert_array_equal(batch[3], own.measure(STATES, 0))


def test_a_course_wraps():
    own = sensor(3, MODEL)
    left = own.residual(np.array([20.0, np.pi - 0.1]), np.array([20.0, 0.1 - np.pi]))
    np.testing.assert_allclose(left, [0.0, -0.2], atol=1e-12)


def test_satellites_come_ten_times_a_second():
    plant = simulated(model_drive(), BMW_320I)
    due = np.flatnonzero(np.isfinite(plant.exact[:, 3, 0, 0]))
    np.testing.assert_array_equal(due, np.arange(0, 100, 20))


def test_sensors_err_as_they_are_told():
    wild = tuple(
        tuple(SensorError(e.std, bias=5 * e.std, changes=((0.25, 4.0),)) for e in channels)
        for channels in ERRORS
    )
    drive = model_drive(2000)
    plant = simulated(drive, BMW_320I, wild)
    draws = plant.draw(lambda purpose, node: np.random.default_rng(node), 2000)
    read = np.array([plant.observe(plant.truth[k], draws.measurement[k], k) for k in range(2000)])
    error = (read - plant.exact)[:, 1, 0]
    std = np.array([e.std for e in ERRORS[1]])
    np.testing.assert_allclose(error[50:].mean(axis=0) / std, 5.0, atol=0.5)
    np.testing.assert_allclose(error[50:].std(axis=0) / std, 4.0, rtol=0.1)
    np.testing.assert_allclose(error[:50].std(axis=0) / std, 1.0, rtol=0.4)


def test_noise_does_not_depend_on_the_number_of_steps():
    plant = simulated(model_drive(), BMW_320I)
    few, all_of_them = (
        plant.draw(lambda purpose, node: np.random.default_rng(node), steps) for steps in (10, 100)
    )
    np.testing.assert_array_equal(few.measurement, all_of_them.measurement[:10])
    with pytest.raises(ValueError, match="ask for 100 or fewer"):
        plant.draw(lambda purpose, node: np.random.default_rng(node), 101)


def test_the_start_errs_as_the_prior_says():
    plant = simulated(model_drive(), BMW_320I)
    noise = np.random.default_rng(1).standard_normal((20_000, 6))
    truth, mean, cov = plant.initial(noise)
    np.testing.assert_array_equal(truth[0], plant.truth[0])
    np.testing.assert_allclose((mean - truth).std(axis=0), PRIOR_STD, rtol=0.03)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), PRIOR_STD)


def test_a_log_is_replayed_at_its_own_times_with_its_own_noise(tmp_path: Path):
    drive = model_drive(50, step_s=0.02)
    write_drive(tmp_path, drive, BMW_320I)
    plant = replayed(*read_log(tmp_path), 0.005)
    assert plant.steps == 197
    came = np.isfinite(plant.exact[:, 1, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(came), np.arange(0, 197, 4))
    np.testing.assert_array_equal(plant.exact[came, 1, 0, 0], drive.yaw_rate_rad_s)
    np.testing.assert_array_equal(plant.truth[came, SIDE_SLIP], drive.side_slip_rad)
    assert np.isnan(plant.truth[:, SPEED]).all()
    assert np.isnan(plant.exact[:, 3]).all()
    noise = np.random.default_rng(1).standard_normal((len(NODES), 1, CHANNELS))
    np.testing.assert_array_equal(plant.observe(plant.truth[0], noise, 0), plant.exact[0])
    _, mean, _ = plant.initial(np.ones(6))
    assert mean[SPEED] == drive.speed_m_s[0]
    assert mean[STEERING] == drive.steering_rad[0]
