"""The two filters that are timed: a straight line seen by its position, and a turn by range and
bearing."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.moments import Model, Residual
from concord.plants.motion import ConstantVelocity, CoordinatedTurn
from concord.plants.range_bearing import RangeBearing

SENSOR_POSITION_M = (-150.0, 80.0)


class BenchmarkCase(NamedTuple):
    """Models for arrays (..., n), the same in plain numbers for one filter at a time, and where it
    begins."""

    name: str
    transition: Model
    measure: Model
    residual: Residual
    transition_of_one: Callable[[np.ndarray, float], np.ndarray]
    measure_of_one: Callable[[np.ndarray], np.ndarray]
    residual_of_one: Residual
    process_noise_cov: np.ndarray
    measurement_noise_cov: np.ndarray
    start: Gaussian


def beliefs(case: BenchmarkCase, lanes: tuple[int, ...]) -> Gaussian:
    """Return the start in every lane."""
    mean, cov = case.start
    return Gaussian(
        np.broadcast_to(mean, (*lanes, *mean.shape)).copy(),
        np.broadcast_to(cov, (*lanes, *cov.shape)).copy(),
    )


def readings(case: BenchmarkCase, lanes: tuple[int, ...]) -> np.ndarray:
    """Of the start, with noise."""
    generator = np.random.default_rng(1)
    exact = case.measure(np.broadcast_to(case.start.mean, (1, *lanes, *case.start.mean.shape)))[0]
    noise = generator.standard_normal(exact.shape)
    return exact + noise * np.sqrt(np.diag(case.measurement_noise_cov))


def _positions(points: np.ndarray) -> np.ndarray:
    seen = np.empty_like(points, shape=(*points.shape[:-1], 2))
    seen[..., 0], seen[..., 1] = points[..., 0], points[..., 2]
    return seen


def _straight_one(x: np.ndarray, dt: float) -> np.ndarray:
    return np.array([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]])


def _turn_one(x: np.ndarray, dt: float) -> np.ndarray:
    px, vx, py, vy, w = x.tolist()
    s, c = math.sin(w * dt), math.cos(w * dt)
    a, b = s / w, (1 - c) / w
    return np.array(
        [px + a * vx - b * vy, c * vx - s * vy, py + b * vx + a * vy, s * vx + c * vy, w]
    )


def _range_bearing_one(x: np.ndarray) -> np.ndarray:
    dx, dy = float(x[0]) - SENSOR_POSITION_M[0], float(x[2]) - SENSOR_POSITION_M[1]
    return np.array([math.sqrt(dx * dx + dy * dy), math.atan2(dy, dx)])


def _wrapped_one(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    difference = a - b
    difference[1] = (difference[1] + math.pi) % (2 * math.pi) - math.pi
    return difference


def straight() -> BenchmarkCase:
    """A: n = 4, m = 2, linear."""
    motion = ConstantVelocity()
    return BenchmarkCase(
        "A",
        lambda points: motion.transition(points, None, 0),
        _positions,
        np.subtract,
        _straight_one,
        lambda x: np.array([x[0], x[2]]),
        np.subtract,
        motion.process_noise_cov(0),
        4.0 * np.eye(2),
        Gaussian(np.array([100.0, 6.0, 300.0, 3.0]), np.diag([400.0, 25.0, 400.0, 25.0])),
    )


def turn() -> BenchmarkCase:
    """B: n = 5, m = 2, a coordinated turn by range and bearing, its bearing wrapped."""
    motion, sensor = CoordinatedTurn(), RangeBearing(np.array(SENSOR_POSITION_M))
    return BenchmarkCase(
        "B",
        lambda points: motion.transition(points, None, 0),
        lambda points: sensor.measure(points, 0),
        sensor.residual,
        _turn_one,
        _range_bearing_one,
        _wrapped_one,
        motion.process_noise_cov(0),
        np.diag(sensor.noise_std**2),
        Gaussian(
            np.array([300.0, 12.0, 150.0, 3.0, 0.048]), np.diag([400.0, 25.0, 400.0, 25.0, 4e-4])
        ),
    )
