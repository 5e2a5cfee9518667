"""Models and random systems shared by the filter tests."""

import numpy as np

from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import SigmaPointRule, cubature, scaled_unscented

BATCHES = [(), (1,), (3, 1, 2)]
SENSOR_POSITION_M = np.array([-150.0, 80.0])


def rules(n: int) -> dict[str, SigmaPointRule]:
    """One rule of every kind; "narrow" has a negative central covariance weight for n > 1."""
    return {
        "unscented": scaled_unscented(n),
        "narrow": scaled_unscented(n, alpha=0.5),
        "cubature": cubature(n),
    }


RULE_NAMES = list(rules(1))


def random_spd(generator: np.random.Generator, lanes: tuple[int, ...], n: int) -> np.ndarray:
    """Random covariances (*lanes, n, n), condition number of some tens."""
    root = generator.standard_normal((*lanes, n, n + 2))
    return root @ root.mT + 0.2 * np.eye(n)


def random_belief(generator: np.random.Generator, lanes: tuple[int, ...], n: int) -> Gaussian:
    return Gaussian(generator.standard_normal((*lanes, n)), random_spd(generator, lanes, n))


def turn(points: np.ndarray) -> np.ndarray:
    """Exact coordinated turn over one second, state [x, vx, y, vy, turn rate]."""
    x, vx, y, vy, rate = (points[..., i] for i in range(5))
    sine, cosine = np.sin(rate), np.cos(rate)
    along, across = sine / rate, (1 - cosine) / rate
    moved = np.empty_like(points)
    moved[..., 0] = x + along * vx - across * vy
    moved[..., 1] = cosine * vx - sine * vy
    moved[..., 2] = y + across * vx + along * vy
    moved[..., 3] = sine * vx + cosine * vy
    moved[..., 4] = rate
    return moved


def range_bearing(points: np.ndarray) -> np.ndarray:
    """Range and bearing of [x, ., y, ., .] from SENSOR_POSITION_M."""
    dx = points[..., 0] - SENSOR_POSITION_M[0]
    dy = points[..., 2] - SENSOR_POSITION_M[1]
    return np.stack([np.sqrt(dx * dx + dy * dy), np.arctan2(dy, dx)], axis=-1)


def wrap(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def bearing_residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Difference of [range, bearing] pairs, bearing wrapped."""
    difference = a - b
    difference[..., 1] = wrap(difference[..., 1])
    return difference


TURN_NOISE_COV = np.zeros((5, 5))
TURN_NOISE_COV[:2, :2] = TURN_NOISE_COV[2:4, 2:4] = 0.05 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]])
TURN_NOISE_COV[4, 4] = 1e-6
RANGE_BEARING_NOISE_COV = np.diag([10.0**2, np.radians(2.0) ** 2])
TURN_START = Gaussian(
    np.array([300.0, 12.0, 150.0, 3.0, 0.048]), np.diag([20.0**2, 5**2, 20.0**2, 5**2, 0.02**2])
)


def turn_track(generator: np.random.Generator, steps: int) -> np.ndarray:
    """Range and bearing (steps, 2) of a random coordinated turn that begins near TURN_START."""
    state = generator.multivariate_normal(*TURN_START)
    measurements = []
    for _ in range(steps):
        state = turn(state) + generator.multivariate_normal(np.zeros(5), TURN_NOISE_COV)
        noise = generator.multivariate_normal(np.zeros(2), RANGE_BEARING_NOISE_COV)
        measurements.append(range_bearing(state) + noise)
    return np.array(measurements)
