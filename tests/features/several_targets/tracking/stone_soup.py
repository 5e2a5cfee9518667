"""Stone Soup's joint probabilistic data association on the case of `position_sensor`."""

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from tests.features.several_targets.tracking.position_sensor import MOTION, PositionSensor

START = datetime(2026, 1, 1)


class StoneSoupTracker:
    """Tracks with a fixed number of targets, updated with the mixture of all hypotheses."""

    def __init__(
        self, mean: np.ndarray, cov: np.ndarray, sensor: PositionSensor, gate_probability: float
    ) -> None:
        from stonesoup.dataassociator.probability import JPDA
        from stonesoup.hypothesiser.probability import PDAHypothesiser
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import (
            CombinedLinearGaussianTransitionModel,
            ConstantVelocity,
        )
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.state import GaussianState
        from stonesoup.types.track import Track
        from stonesoup.updater.kalman import KalmanUpdater

        density = MOTION.acceleration_density_m2_s3
        model = CombinedLinearGaussianTransitionModel([ConstantVelocity(density)] * 2)
        self.measurement = LinearGaussian(4, (0, 2), sensor.noise_cov)
        self.updater = KalmanUpdater(self.measurement)
        hypothesiser = PDAHypothesiser(
            KalmanPredictor(model), self.updater, sensor.density, sensor.detection,
            gate_probability,
        )  # fmt: skip
        self.associator = JPDA(hypothesiser)
        self.tracks = [
            Track([GaussianState(m[:, None], c, timestamp=START)])
            for m, c in zip(mean, cov, strict=True)
        ]

    def associated(self, detections: np.ndarray, step: int) -> dict:
        """Return the hypotheses of all tracks with their probabilities."""
        from stonesoup.types.detection import Detection

        when = START + timedelta(seconds=step)
        given = {Detection(d[:, None], when, self.measurement) for d in detections}
        return self.associator.associate(set(self.tracks), given, when)

    def probabilities(self, hypotheses: dict, detections: np.ndarray) -> np.ndarray:
        """Probability (T, 1 + D) of no detection, and of each."""
        found = np.zeros((len(self.tracks), 1 + len(detections)))
        for row, track in enumerate(self.tracks):
            for one in hypotheses[track]:
                place = 0
                if one:
                    same = (detections == one.measurement.state_vector.ravel()).all(axis=1)
                    place = 1 + int(np.flatnonzero(same)[0])
                found[row, place] = float(one.probability)
        return found

    def update(self, hypotheses: dict) -> tuple[np.ndarray, np.ndarray]:
        """Return means (T, 4) and covariances (T, 4, 4) given the hypotheses."""
        from stonesoup.functions import gm_reduce_single
        from stonesoup.types.array import StateVectors
        from stonesoup.types.update import GaussianStateUpdate

        for track in self.tracks:
            every = hypotheses[track]
            states: list = [self.updater.update(one) if one else one.prediction for one in every]
            mean, cov = gm_reduce_single(
                StateVectors([state.state_vector for state in states]),
                np.stack([state.covar for state in states], axis=2),
                np.array([float(one.probability) for one in every]),
            )
            track.append(
                GaussianStateUpdate(mean, cov, every, timestamp=every[0].measurement.timestamp)
            )
        means = np.array([np.asarray(t.state_vector, float).ravel() for t in self.tracks])
        return means, np.array([np.asarray(t.covar, float) for t in self.tracks])


def crossing_targets(
    steps: int, targets: int, clutter: float, sensor: PositionSensor, seed: int
) -> tuple[np.ndarray, Sequence[np.ndarray]]:
    """Truth (steps, K, 4) of targets through the middle of a square of 200 m, and detections."""
    rng = np.random.default_rng(seed)
    angle = np.pi * np.arange(targets) / targets
    speed = 180 / steps
    velocity = speed * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    time = np.arange(steps) - steps / 2 + rng.uniform(-4, 4, (targets, 1))
    truth = np.empty((steps, targets, 4))
    truth[..., ::2] = (time[..., None] * velocity[:, None, :]).swapaxes(0, 1)
    truth[..., 1::2] = velocity
    scans = []
    for states in truth:
        taken = states[rng.random(targets) < sensor.detection][:, ::2]
        taken = taken + sensor.std * rng.standard_normal(taken.shape)
        false = rng.uniform(-100, 100, (rng.poisson(clutter), 2))
        scans.append(np.concatenate((taken, false)))
    return truth, scans
