"""Manoeuvres as data: programs of steering and speed, and a driver that follows a path."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np


class CarMotion(NamedTuple):
    """Motion of the car as its driver sees it: place m, heading rad, speeds m/s along and across
    it."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    lateral_speed_m_s: float


class Program(NamedTuple):
    """A quantity by time: straight lines between knots, held before the first and after the last.

    `times_s` ascend; equal times make a step.
    """

    times_s: tuple[float, ...]
    values: tuple[float, ...]

    def at(self, time_s: float) -> float:
        """Return the value at a time."""
        return float(np.interp(time_s, self.times_s, self.values))


class Sine(NamedTuple):
    """A sine of `amplitude` from time 0."""

    amplitude: float
    frequency_hz: float

    def at(self, time_s: float) -> float:
        """Return the value at a time."""
        return self.amplitude * math.sin(2 * math.pi * self.frequency_hz * time_s)


class SineWithDwell(NamedTuple):
    """One period of a sine from `start_s`, held for `dwell_s` at its second peak (ISO 19365)."""

    amplitude: float
    frequency_hz: float
    start_s: float
    dwell_s: float

    def at(self, time_s: float) -> float:
        """Return the value at a time."""
        period = 1 / self.frequency_hz
        since = time_s - self.start_s
        held = max(since - self.dwell_s, min(since, 0.75 * period))
        if since < 0 or held > period:
            return 0.0
        return self.amplitude * math.sin(2 * math.pi * self.frequency_hz * held)


class Signal(Protocol):
    """A quantity by time."""

    def at(self, time_s: float) -> float: ...


class Driver(Protocol):
    """Driver that steers.

    `steering(time, motion)` is the commanded road-wheel angle in rad; `lag_s` is the delay of the
    wheels.
    """

    @property
    def lag_s(self) -> float: ...

    def steering(self, time_s: float, motion: CarMotion) -> float: ...


class OpenLoop(NamedTuple):
    """Driver that steers by the clock."""

    angle: Signal
    lag_s: float = 0.01

    def steering(self, time_s: float, motion: CarMotion) -> float:
        """Return the program's angle."""
        return self.angle.at(time_s)


class PathFollower(NamedTuple):
    """Driver that looks ahead and steers so that the car would meet the path there.

    The angle is that of the circle through the point `preview_s` ahead on `path`, a lateral
    position by distance. Source: MacAdam (1981), Application of an optimal preview control for
    simulation of closed-loop automobile driving, with one preview point.
    """

    path: Program
    wheelbase_m: float
    preview_s: float
    lag_s: float

    def steering(self, time_s: float, motion: CarMotion) -> float:
        """Return the angle wanted now."""
        ahead = self.preview_s * motion.speed_m_s
        course = motion.heading_rad + math.atan2(motion.lateral_speed_m_s, motion.speed_m_s)
        there = motion.y_m + ahead * math.sin(course)
        wanted = self.path.at(motion.x_m + ahead * math.cos(motion.heading_rad))
        return 2 * self.wheelbase_m * (wanted - there) / ahead**2


@dataclass(frozen=True)
class Manoeuvre:
    """Named drive: its driver and its speed."""

    name: str
    summary: str
    duration_s: float
    driver: Driver
    speed_m_s: Signal


def _double_lane_change(lane_m: float = 3.5, cut_m: float = 6.0, lead_m: float = 30.0) -> Program:
    """The middle of an ISO 3888-1 track: 15, 30, 25, 25 and 15 m, entered early by `cut_m`."""
    corners = (15.0 - cut_m, 45.0 - cut_m, 70.0 - cut_m, 95.0 - cut_m)
    return Program(tuple(lead_m + corner for corner in corners), (0.0, lane_m, lane_m, 0.0))


def _constant(value: float) -> Program:
    return Program((0.0,), (value,))


MANOEUVRES = {
    manoeuvre.name: manoeuvre
    for manoeuvre in (
        Manoeuvre(
            "double-lane-change",
            "ISO 3888-1 track at 22 m/s under a driver who looks half a second ahead",
            12.0,
            PathFollower(_double_lane_change(), 2.58, preview_s=0.5, lag_s=0.1),
            _constant(22.0),
        ),
        Manoeuvre(
            "serpentine",
            "sinusoidal steering of .05 rad at .35 Hz while the car gains speed, 16 to 19.6 m/s",
            12.0,
            OpenLoop(Sine(0.05, 0.35)),
            Program((0.0, 12.0), (16.0, 20.0)),
        ),
        Manoeuvre(
            "step-steer",
            "a step of .04 rad at 20 m/s (ISO 7401)",
            6.0,
            OpenLoop(Program((1.0, 1.1), (0.0, 0.04))),
            _constant(20.0),
        ),
        Manoeuvre(
            "sine-with-dwell",
            "one period of .045 rad at .7 Hz, held for half a second, at 22 m/s (ISO 19365)",
            6.0,
            OpenLoop(SineWithDwell(0.045, 0.7, start_s=1.0, dwell_s=0.5)),
            _constant(22.0),
        ),
        Manoeuvre(
            "ramp-steer",
            "steering that grows by .008 rad/s at 15 m/s (ISO 4138): all slips up to the limit",
            12.0,
            OpenLoop(Program((1.0, 12.0), (0.0, 0.088))),
            _constant(15.0),
        ),
        Manoeuvre(
            "braking-in-a-turn",
            "steady cornering at 20 m/s, then braking to 10 m/s (ISO 7975)",
            8.0,
            OpenLoop(Program((0.5, 1.0), (0.0, 0.03))),
            Program((3.0, 6.0), (20.0, 10.0)),
        ),
    )
}
