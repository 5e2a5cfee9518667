"""Simulated cars: integrated accurately, consistent with themselves, refused when they spin."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from concord.features.vehicle.plant.drive import FRONT_LEFT, FRONT_RIGHT, REAR_LEFT, REAR_RIGHT
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES, OpenLoop, Program
from concord.features.vehicle.plant.model import linear_tyre, single_track
from concord.features.vehicle.plant.truth import (
    BMW,
    SOFT_BMW,
    SpunOut,
    TrueCar,
    data_sheet,
    simulate,
)

installed = pytest.mark.skipif(
    importlib.util.find_spec("vehiclemodels") is None, reason="needs the extra vehicle"
)
SHORT = replace(MANOEUVRES["serpentine"], duration_s=1.5)
GENTLE = replace(
    MANOEUVRES["step-steer"],
    driver=OpenLoop(Program((0.2, 0.5), (0.0, 0.006))),
    duration_s=3.0,
)


@installed
def test_half_the_integration_step_changes_nothing_that_matters():
    coarse, fine = (simulate(SHORT, BMW, 0.01, integration_step_s=h) for h in (1e-3, 5e-4))
    for name in ("yaw_rate_rad_s", "side_slip_rad", "speed_m_s", "heading_rad"):
        assert np.abs(getattr(coarse, name) - getattr(fine, name)).max() < 1e-4, name


@installed
def test_what_a_drive_says_agrees_with_itself():
    drive = simulate(SHORT, BMW, 0.01)
    rate = np.gradient(drive.heading_rad, 0.01)
    np.testing.assert_allclose(rate[2:-2], drive.yaw_rate_rad_s[2:-2], atol=2e-3)
    vy = drive.lateral_speed_m_s
    felt = np.gradient(vy, 0.01) + drive.yaw_rate_rad_s * drive.speed_m_s
    np.testing.assert_allclose(felt[2:-2], drive.lateral_acceleration_m_s2[2:-2], atol=0.15)
    pushed = np.gradient(drive.speed_m_s, 0.01) - drive.yaw_rate_rad_s * vy
    np.testing.assert_allclose(pushed[2:-2], drive.longitudinal_acceleration_m_s2[2:-2], atol=0.05)


@installed
def test_the_outer_wheels_are_the_faster_ones():
    """To the left, positive yaw rate: the right wheels, by track times yaw rate."""
    drive = simulate(GENTLE, BMW, 0.01)
    assert drive.yaw_rate_rad_s[-1] > 0.02
    wheels, car = drive.wheel_speed_m_s[-1], data_sheet(BMW)
    for left, right, track in (
        (FRONT_LEFT, FRONT_RIGHT, car.front_track_m),
        (REAR_LEFT, REAR_RIGHT, car.rear_track_m),
    ):
        expected = track * drive.yaw_rate_rad_s[-1]
        assert wheels[right] - wheels[left] == pytest.approx(expected, rel=0.1)


@installed
def test_gentle_cornering_is_the_single_track_models():
    drive = simulate(GENTLE, BMW, 0.01)
    model = single_track(data_sheet(BMW), linear_tyre, 0.01, np.eye(3))
    state = drive.states[0]
    for control in drive.inputs[:-1]:
        state = model.transition(state, control, 0)
    assert state[0] == pytest.approx(drive.yaw_rate_rad_s[-1], rel=0.06)


@installed
def test_a_car_that_spins_is_refused_with_the_time():
    with pytest.raises(SpunOut, match=r"spins out at \d"):
        simulate(MANOEUVRES["double-lane-change"], SOFT_BMW, 0.01, integration_step_s=2e-3)


@installed
def test_tyres_can_be_changed():
    soft = data_sheet(TrueCar("soft", 2, {"p_ky1": -10.96}))
    assert soft.front_stiffness_n_rad == pytest.approx(data_sheet(BMW).front_stiffness_n_rad / 2)


@installed
def test_steps_must_fit():
    with pytest.raises(ValueError, match="multiple"):
        simulate(SHORT, BMW, 0.0105)


def test_without_the_library_the_cure_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match="make extras"):
        simulate(SHORT, BMW, 0.01)
