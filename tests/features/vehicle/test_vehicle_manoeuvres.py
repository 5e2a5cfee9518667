"""Drivers and their programs."""

import math

import numpy as np
import pytest

from concord.features.vehicle.plant.manoeuvres import (
    MANOEUVRES,
    CarMotion,
    OpenLoop,
    PathFollower,
    Program,
    SineWithDwell,
)


def test_a_program_goes_straight_between_its_knots_and_holds_beyond():
    program = Program((1.0, 3.0), (0.0, 4.0))
    assert [program.at(t) for t in (-5.0, 1.0, 2.0, 3.0, 9.0)] == [0.0, 0.0, 2.0, 4.0, 4.0]


def test_the_dwell_is_held_at_the_second_peak():
    signal = SineWithDwell(1.0, 0.5, start_s=1.0, dwell_s=0.7)
    assert signal.at(0.99) == 0.0
    assert signal.at(1.5) == pytest.approx(1.0)
    assert signal.at(2.5) == pytest.approx(-1.0)
    assert signal.at(3.19) == pytest.approx(-1.0)
    assert signal.at(3.71) == 0.0
    times = np.arange(0, 5, 1e-3)
    steps = np.abs(np.diff([signal.at(t) for t in times]))
    assert steps.max() < 1.1 * math.pi * 1e-3


def test_the_double_lane_change_is_the_iso_track():
    driver = MANOEUVRES["double-lane-change"].driver
    assert isinstance(driver, PathFollower)
    start, reached, left, back = driver.path.times_s
    assert (reached - start, left - reached, back - left) == (30.0, 25.0, 25.0)
    assert driver.path.values == (0.0, 3.5, 3.5, 0.0)


def test_the_driver_steers_the_circle_through_the_point_ahead():
    """From the origin, heading along x, at lateral offset e after distance d: radius d^2 / 2 e."""
    follower = PathFollower(Program((0.0,), (0.5,)), 2.5, preview_s=1.0, lag_s=0.1)
    angle = follower.steering(0.0, CarMotion(0.0, 0.0, 0.0, 20.0, 0.0))
    radius = 20.0**2 / (2 * 0.5)
    assert angle == pytest.approx(2.5 / radius)
    assert follower.steering(0.0, CarMotion(0.0, 0.5, 0.0, 20.0, 0.0)) == 0.0


def test_names_and_durations_are_sensible():
    for name, manoeuvre in MANOEUVRES.items():
        assert manoeuvre.name == name
        assert 5 <= manoeuvre.duration_s <= 60
        assert manoeuvre.speed_m_s.at(0.0) > 5
        if isinstance(manoeuvre.driver, OpenLoop):
            angles = [manoeuvre.driver.angle.at(t) for t in np.arange(0, 12, 0.01)]
            assert 0.01 < max(map(abs, angles)) < 0.1
