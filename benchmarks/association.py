"""One step of joint probabilistic data association with ten targets, beside Stone Soup.

Both predict ten tracks, gate fifteen detections on average, compute the joint probabilities and
merge each track's hypotheses. The targets stand in pairs that share detections. Stone Soup's JPDA
sums over all joint hypotheses, its JPDA with EHM over a hypothesis tree of each cluster.
"""

import time
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np

from benchmarks.measure import BenchmarkFigures, figure, in_turns, median_us, ratio, say
from concord.features.several_targets.association.associate import joint_probabilities
from concord.features.several_targets.tracking.tracker import Scan, TrackerSettings, track
from concord.features.several_targets.tracking.tracks import Tracks
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature
from concord.plants.motion import ConstantVelocity

TARGETS, CLUTTER, SCANS, TURNS, REPEATS = 10, 5, 3, 5, 20
DETECTION, GATE_PROBABILITY, STD_M, SIDE_M = 0.9, 0.99, 2.0, 200.0
MOTION = ConstantVelocity(acceleration_density_m2_s3=0.5)
START = datetime(2026, 1, 1)


class PositionScans(NamedTuple):
    """A sensor of positions with uniform clutter over the square."""

    noise_cov: np.ndarray = STD_M**2 * np.eye(2)

    def measure(self, state: np.ndarray) -> np.ndarray:
        """Return the positions (..., 2) of states (..., 4)."""
        return state[..., ::2]

    def residual(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return a - b (..., 2)."""
        return a - b

    def detection_probability(self, state: np.ndarray) -> np.ndarray:
        """Return that of states (..., 4), equal everywhere."""
        return np.full(state.shape[:-1], DETECTION)

    def clutter_density(self, detections: np.ndarray) -> np.ndarray:
        """Return the clutter (D,) per square metre."""
        return np.full(len(detections), CLUTTER / SIDE_M**2)

    def begun(self, detections: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return tracks that begin here; the tracker of this benchmark begins none."""
        return np.zeros((len(detections), 4)), np.zeros((len(detections), 4, 4))


def tracks_and_scans() -> tuple[Tracks, list[np.ndarray]]:
    """Return ten tracks in pairs at a distance of 6 m, and scans of the step that follows."""
    rng = np.random.default_rng(1)
    mean = np.zeros((TARGETS, 4))
    mean[:, 0] = 40.0 * (np.arange(TARGETS) // 2) - 80
    mean[:, 2] = 6.0 * (np.arange(TARGETS) % 2)
    cov = np.broadcast_to(np.diag([4.0, 1, 4, 1]), (TARGETS, 4, 4)).copy()
    identity = np.stack((np.zeros(TARGETS), np.zeros(TARGETS), np.arange(TARGETS)), axis=1)
    tracks = Tracks(
        Gaussian(mean, cov), np.ones(TARGETS), identity.astype(int), np.ones(TARGETS, dtype=bool)
    )
    scans = []
    for _ in range(SCANS):
        taken = mean[rng.random(TARGETS) < DETECTION][:, ::2]
        taken = taken + STD_M * rng.standard_normal(taken.shape)
        false = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (CLUTTER, 2))
        scans.append(np.concatenate((taken, false)))
    return tracks, scans


def ours(tracks: Tracks, scans: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the means (T, 4) after each scan, each from the same tracks."""
    settings = TrackerSettings(
        lambda states: MOTION.transition(states, None, 0),
        MOTION.process_noise_cov(0),
        cubature(4),
        joint_probabilities,
        gate_probability=GATE_PROBABILITY,
        survival=1.0,
        birth=0.0,
        end_below=0.0,
        same_within=-1.0,
    )
    sensor = PositionScans()
    return [track(tracks, [Scan(0, sensor, one)], settings, 1).tracks.belief.mean for one in scans]


def stone_soup(associator_name: str, given: Tracks, scans: Sequence[np.ndarray]) -> Callable:
    """Return a function with the result of `ours`, by an associator of Stone Soup."""
    from stonesoup.dataassociator import probability
    from stonesoup.functions import gm_reduce_single
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
    )
    from stonesoup.models.transition.linear import ConstantVelocity as Straight
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
    from stonesoup.updater.kalman import KalmanUpdater

    model = CombinedLinearGaussianTransitionModel([Straight(MOTION.acceleration_density_m2_s3)] * 2)
    measurement = LinearGaussian(4, (0, 2), STD_M**2 * np.eye(2))
    updater = KalmanUpdater(measurement)
    hypothesiser = PDAHypothesiser(
        KalmanPredictor(model), updater, CLUTTER / SIDE_M**2, DETECTION, GATE_PROBABILITY
    )
    associator = getattr(probability, associator_name)(hypothesiser)
    tracks = [
        Track([GaussianState(mean[:, None], cov, timestamp=START)])
        for mean, cov in zip(*given.belief, strict=True)
    ]
    when = START + timedelta(seconds=1)

    def merged(hypotheses: Sequence) -> np.ndarray:
        states: list = [updater.update(one) if one else one.prediction for one in hypotheses]
        mean, _ = gm_reduce_single(
            StateVectors([state.state_vector for state in states]),
            np.stack([state.covar for state in states], axis=2),
            np.array([float(one.probability) for one in hypotheses]),
        )
        return np.asarray(mean, dtype=float).ravel()

    def step() -> list[np.ndarray]:
        found = []
        for one in scans:
            detections = {Detection(place[:, None], when, measurement) for place in one}
            every = associator.associate(set(tracks), detections, when)
            found.append(np.array([merged(every[track]) for track in tracks]))
        return found

    return step


def main() -> BenchmarkFigures:
    """Print and return what a step costs, and how many times Stone Soup's speed that is."""
    tracks, scans = tracks_and_scans()
    expected = ours(tracks, scans)
    contestants = {"concord": _timed(lambda: ours(tracks, scans), REPEATS)}
    for name in ("JPDA", "JPDAwithEHM"):
        run = stone_soup(name, tracks, scans)
        for right, found in zip(expected, run(), strict=True):
            np.testing.assert_allclose(found, right, rtol=1e-9, atol=1e-9)
        contestants[f"Stone Soup {name}"] = _timed(run, 1)
    given = in_turns(contestants, TURNS)
    say(f"association, {TARGETS} targets, {CLUTTER} clutter detections, {TURNS} turns")
    results: BenchmarkFigures = {}
    for name, spent in given.items():
        results[f"{name} us"] = figure([1e6 * one for one in spent], "us/step", "less")
        line = f"  {name:<24}{median_us(spent):>12.0f} us per step"
        if name != "concord":
            beside = results[f"concord x {name}"] = ratio(spent, given["concord"])
            line += f"{beside.value:>9.0f} x as long ({beside.low:.0f} - {beside.high:.0f})"
        say(line)
    return results


def _timed(run: Callable[[], object], repeats: int) -> Callable[[], float]:
    """Seconds of the processor per step."""

    def once() -> float:
        started = time.thread_time()
        for _ in range(repeats):
            run()
        return (time.thread_time() - started) / (repeats * SCANS)

    return once


if __name__ == "__main__":
    main()
