"""A linear sensor of positions for tests of the tracker, and its settings."""

from typing import NamedTuple

import numpy as np

from concord.features.several_targets.association.associate import ASSOCIATIONS
from concord.features.several_targets.tracking.tracker import TrackerSettings
from concord.features.several_targets.tracking.tracks import Tracks
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature
from concord.plants.motion import ConstantVelocity

MOTION = ConstantVelocity(acceleration_density_m2_s3=0.5)


class PositionSensor(NamedTuple):
    """Sees x and y of [x, vx, y, vy] where x is below `reach`, with uniform clutter."""

    detection: float = 0.9
    density: float = 1e-4
    std: float = 2.0
    reach: float = np.inf

    @property
    def noise_cov(self) -> np.ndarray:
        return self.std**2 * np.eye(2)

    def measure(self, state: np.ndarray) -> np.ndarray:
        return state[..., ::2]

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a - b

    def detection_probability(self, state: np.ndarray) -> np.ndarray:
        return np.where(state[..., 0] < self.reach, self.detection, 0.0)

    def clutter_density(self, detections: np.ndarray) -> np.ndarray:
        return np.full(len(detections), self.density)

    def begun(self, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = np.zeros((len(detections), 4))
        mean[:, ::2] = detections
        variances = np.array([self.std**2, 25.0, self.std**2, 25.0])
        return mean, np.broadcast_to(np.diag(variances), (len(detections), 4, 4)).copy()


def settings(association: str = "jpda", **changed: float) -> TrackerSettings:
    return TrackerSettings(
        lambda states: MOTION.transition(states, None, 0),
        MOTION.process_noise_cov(0),
        cubature(4),
        ASSOCIATIONS[association],
        **changed,  # pyright: ignore[reportArgumentType]
    )


def tracks_at(mean: np.ndarray, existence: float = 1.0) -> Tracks:
    """Confirmed tracks with means (T, 4)."""
    count = len(mean)
    return Tracks(
        Gaussian(
            mean.astype(float), np.broadcast_to(np.diag([9.0, 4, 9, 4]), (count, 4, 4)).copy()
        ),
        np.full(count, existence),
        np.stack((np.zeros(count), np.zeros(count), np.arange(count)), axis=1).astype(int),
        np.ones(count, dtype=bool),
    )
