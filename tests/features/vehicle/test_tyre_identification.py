"""Identification finds the tyres that made a drive, and refuses drives that cannot tell."""

from functools import cache

import msgspec
import numpy as np
import pytest

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import axles_of, linear_tyre, single_track, tanh_tyre
from concord.features.vehicle.plant.parameters import BMW_320I, Car
from concord.features.vehicle.plant.tyre_identification import (
    LEAST_CORNERING_M_S2,
    Identified,
    identify,
)

TRUE = msgspec.structs.replace(
    BMW_320I, front_stiffness_n_rad=90e3, rear_stiffness_n_rad=140e3, friction=0.8
)
STEERING_OFFSET, ACCELERATION_OFFSET = 0.003, 0.2


@cache
def drive(car: Car, tyre, amplitude: float, noise: float = 1.0, step_s: float = 0.005) -> Drive:
    """A drive of the model itself, logged with noise and offsets."""
    generator = np.random.default_rng(3)
    steps = round(8.0 / step_s)
    model = single_track(car, tyre, step_s, np.eye(3))
    time_s = step_s * np.arange(steps, dtype=np.float64)
    steering = amplitude * np.sin(3 * time_s) * np.minimum(1, time_s / 4)
    states, accelerations = [np.array([0.0, 0.0, 20.0])], []
    for angle in steering:
        accelerations.append(model.accelerations(states[-1], np.array([angle, 0.0]))[0])
        moved = model.transition(states[-1], np.array([angle, 0.0]), 0)
        states.append(np.array([*moved[:2], 20.0]))
    yaw_rate, side_slip, speed = np.array(states[:-1]).T
    unknown = np.full(steps, np.nan)

    def noisy(values, std):
        return values + noise * std * generator.standard_normal(steps)

    return Drive(
        step_s,
        steering - STEERING_OFFSET,
        noisy(yaw_rate, 0.005),
        noisy(side_slip, 0.001),
        speed,
        unknown,
        noisy(np.array(accelerations) + ACCELERATION_OFFSET, 0.1),
        np.full((steps, 4), np.nan),
        unknown,
    )


@cache
def found_in_curves() -> Identified:
    """A drive of moderate curves tells these values."""
    return identify(drive(TRUE, tanh_tyre, 0.03), BMW_320I, tanh_tyre)


@pytest.mark.parametrize(("tyre", "slip_is_logged"), [(linear_tyre, False), (tanh_tyre, True)])
def test_it_finds_the_stiffness_within_its_own_errors(tyre, slip_is_logged):
    logged = drive(TRUE, tyre, 0.03)
    if not slip_is_logged:
        logged = logged._replace(side_slip_rad=np.full(logged.steps, np.nan))
    start = msgspec.structs.replace(BMW_320I, friction=TRUE.friction)
    found = identify(logged, start, tyre)
    truth = np.array([TRUE.front_stiffness_n_rad, TRUE.rear_stiffness_n_rad])
    ours = np.array([found.car.front_stiffness_n_rad, found.car.rear_stiffness_n_rad])
    assert (np.abs(ours - truth) < 4 * found.stiffness_std_n_rad).all()
    assert (np.abs(ours / truth - 1) < 0.03).all()
    assert found.steering_offset_rad == pytest.approx(STEERING_OFFSET, abs=3e-4)
    # The residual is the noise; its relative standard error is 1 / sqrt(2 * 1600).
    np.testing.assert_allclose(found.residual_rms[:2], [0.005, 0.1], rtol=0.08)
    assert np.isnan(found.residual_rms[2]) == (not slip_is_logged)


@pytest.mark.parametrize("added_rad", [-0.1, 0.1])
def test_a_steering_that_reads_six_degrees_wrong_changes_nothing_else(added_rad: float):
    logged = drive(TRUE, tanh_tyre, 0.03)
    wrong = logged._replace(steering_rad=logged.steering_rad - added_rad)
    one, other = found_in_curves(), identify(wrong, BMW_320I, tanh_tyre)
    assert other.steering_offset_rad - one.steering_offset_rad == pytest.approx(added_rad, abs=1e-5)
    for ours, theirs in zip(axles_of(other.car), axles_of(one.car), strict=True):
        assert ours == pytest.approx(theirs, rel=1e-4)


def test_it_finds_the_friction_near_the_limit():
    found = identify(drive(TRUE, tanh_tyre, 0.06), BMW_320I, tanh_tyre, seek_friction=True)
    assert abs(found.car.friction - TRUE.friction) < 4 * found.friction_std
    assert found.car.friction == pytest.approx(TRUE.friction, rel=0.03)


def test_without_noise_it_is_exact_whatever_the_log_is_sampled_at():
    logged = drive(TRUE, tanh_tyre, 0.05, noise=0.0)
    found = identify(logged, BMW_320I, tanh_tyre, seek_friction=True)
    for ours, truth in zip(axles_of(found.car), axles_of(TRUE), strict=True):
        assert ours == pytest.approx(truth, rel=1e-4)
    coarse = Drive(0.01, *(values[::2] for values in logged[1:]))
    found = identify(coarse, BMW_320I, tanh_tyre, seek_friction=True)
    for ours, truth in zip(axles_of(found.car), axles_of(TRUE), strict=True):
        assert ours == pytest.approx(truth, rel=2e-3)


def test_channels_may_begin_and_end_at_different_times():
    logged = drive(TRUE, tanh_tyre, 0.05, noise=0.0)
    steering, speed = logged.steering_rad.copy(), logged.speed_m_s.copy()
    steering[:3], speed[-2:] = np.nan, np.nan
    told = logged._replace(steering_rad=steering, speed_m_s=speed)
    found = identify(told, BMW_320I, tanh_tyre, seek_friction=True)
    for ours, truth in zip(axles_of(found.car), axles_of(TRUE), strict=True):
        assert ours == pytest.approx(truth, rel=1e-2)


def test_a_drive_without_curves_tells_offsets_and_leaves_the_tyres():
    straight = drive(TRUE, tanh_tyre, 0.001)
    found = identify(straight, BMW_320I, tanh_tyre, seek_friction=True)
    assert found.car == BMW_320I
    assert np.isnan([*found.stiffness_std_n_rad, found.friction_std]).all()
    assert found.cornering_m_s2 < LEAST_CORNERING_M_S2
    assert found.steering_offset_rad == pytest.approx(STEERING_OFFSET, abs=3e-4)
    unknown = np.full(straight.steps, np.nan)
    alone = straight._replace(lateral_acceleration_m_s2=unknown, side_slip_rad=unknown)
    by_yaw_rate = identify(alone, BMW_320I, tanh_tyre).steering_offset_rad
    assert by_yaw_rate == pytest.approx(STEERING_OFFSET, abs=3e-4)


def test_the_longest_part_without_a_gap_is_fitted():
    logged = drive(TRUE, tanh_tyre, 0.03)
    steering = logged.steering_rad.copy()
    steering[790:800] = np.nan
    gap = identify(logged._replace(steering_rad=steering), BMW_320I, tanh_tyre)
    rest = Drive(logged.time_step_s, *(values[800:] for values in logged[1:]))
    whole, part = found_in_curves(), identify(rest, BMW_320I, tanh_tyre)
    duration_s = logged.time_step_s * logged.steps
    assert whole.part_s == pytest.approx((0.0, duration_s))
    assert gap.part_s == pytest.approx((800 * logged.time_step_s, duration_s))
    assert gap.car == part.car


def test_a_drive_that_is_too_slow_is_refused():
    slow = drive(TRUE, linear_tyre, 0.03)
    with pytest.raises(ValueError, match="half a second"):
        identify(slow._replace(speed_m_s=np.full(slow.steps, 2.0)), BMW_320I)
    with pytest.raises(ValueError, match="0 yaw rates"):
        identify(slow._replace(speed_m_s=np.full(slow.steps, np.nan)), BMW_320I)
