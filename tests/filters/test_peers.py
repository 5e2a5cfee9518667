"""Several steps of tracking against filterpy and Stone Soup, which share no code with us."""

from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest

from concord.filters import ukf
from concord.filters.filter import Affine
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import scaled_unscented
from concord.filters.smoother import backward, backward_affine, smooth
from tests.filters.support import (
    RANGE_BEARING_NOISE_COV,
    SENSOR_POSITION_M,
    TURN_NOISE_COV,
    TURN_START,
    bearing_residual,
    range_bearing,
    turn,
    turn_track,
)

STEPS = 10
START_TIME = datetime(2020, 1, 1)
CRUISE = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])  # [x, vx, y, vy] over one second
CRUISE_NOISE_COV = TURN_NOISE_COV[:4, :4]
CRUISE_START = Gaussian(TURN_START.mean[:4], TURN_START.cov[:4, :4])
POSITION_NOISE_COV = np.diag([4.0, 9.0])


def positions(points):
    return points[..., [0, 2]]


def cruise_track() -> np.ndarray:
    generator = np.random.default_rng(7)
    velocities = generator.normal([12.0, 3.0], 2.0, (STEPS, 2))
    return np.array([300.0, 150.0]) + np.cumsum(velocities, axis=0)


def our_beliefs(start, transition, noise_cov, measure, measurement_cov, residual, track):
    rule, belief = scaled_unscented(len(start.mean)), start
    for measurement in track:
        belief = ukf.predict(belief, transition, noise_cov, rule)
        belief = ukf.update(
            belief, measurement, measure, measurement_cov, rule, residual=residual
        ).belief
        yield belief


def our_cruise(track):
    return our_beliefs(
        CRUISE_START,
        lambda x: x @ CRUISE.T,
        CRUISE_NOISE_COV,
        positions,
        POSITION_NOISE_COV,
        np.subtract,
        track,
    )


def our_turn(track):
    return our_beliefs(
        TURN_START,
        turn,
        TURN_NOISE_COV,
        range_bearing,
        RANGE_BEARING_NOISE_COV,
        bearing_residual,
        track,
    )


def assert_close(ours: Gaussian, mean, cov, tolerance: float) -> None:
    """Relative to the mean or its deviation, the larger; covariances to their deviations."""
    deviations = np.sqrt(np.diagonal(ours.cov))
    assert (np.abs(ours.mean - mean) < tolerance * np.maximum(np.abs(mean), deviations)).all()
    assert (np.abs(ours.cov - cov) < tolerance * np.outer(deviations, deviations)).all()


def filterpy_filter(start, transition, noise_cov, measure, measurement_cov, residual):
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    n, m = len(start.mean), len(measurement_cov)
    points = MerweScaledSigmaPoints(n, alpha=1.0, beta=2.0, kappa=3.0 - n)
    peer = UnscentedKalmanFilter(
        dim_x=n,
        dim_z=m,
        dt=1.0,
        hx=measure,
        fx=lambda x, dt: transition(x),
        points=points,
        residual_z=residual,
    )
    peer.x, peer.P, peer.Q, peer.R = start.mean.copy(), start.cov.copy(), noise_cov, measurement_cov
    return peer


@pytest.mark.parametrize("kind", ["linear", "turn"])
def test_filterpy_agrees_to_rounding(kind):
    if kind == "linear":
        track = cruise_track()
        ours = our_cruise(track)
        peer = filterpy_filter(
            CRUISE_START,
            lambda x: CRUISE @ x,
            CRUISE_NOISE_COV,
            positions,
            POSITION_NOISE_COV,
            np.subtract,
        )
    else:
        track = turn_track(np.random.default_rng(8), STEPS)
        ours = our_turn(track)
        peer = filterpy_filter(
            TURN_START,
            turn,
            TURN_NOISE_COV,
            range_bearing,
            RANGE_BEARING_NOISE_COV,
            bearing_residual,
        )
    for measurement, belief in zip(track, ours, strict=True):
        peer.predict()
        peer.update(measurement)
        assert_close(belief, peer.x, peer.P, 1e-12)


def test_filterpys_unscented_smoother_agrees_to_rounding():
    """On a turn, over the whole history of its own filter."""
    peer = filterpy_filter(
        TURN_START,
        turn,
        TURN_NOISE_COV,
        range_bearing,
        RANGE_BEARING_NOISE_COV,
        bearing_residual,
    )
    track = turn_track(np.random.default_rng(9), STEPS)
    means, covs, _, _ = filterpy_history(peer, track)
    smoothed, smoothed_covs, _ = peer.rts_smoother(means, covs)
    history, rule = Gaussian(means, covs), scaled_unscented(5)
    ways = [
        backward(Gaussian(mean, cov), turn, TURN_NOISE_COV, rule)
        for mean, cov in zip(means[:-1], covs[:-1], strict=True)
    ]
    ours = smooth(history, ways)
    for step in range(len(track)):
        belief = Gaussian(ours.mean[step], ours.cov[step])
        assert_close(belief, smoothed[step], smoothed_covs[step], 1e-9)


def test_filterpys_linear_smoother_agrees_to_rounding():
    from filterpy.kalman import KalmanFilter

    n, track = len(CRUISE_START.mean), cruise_track()
    peer: Any = KalmanFilter(dim_x=n, dim_z=len(POSITION_NOISE_COV))
    peer.x, peer.P = CRUISE_START.mean.copy(), CRUISE_START.cov.copy()
    peer.F, peer.Q, peer.R = CRUISE, CRUISE_NOISE_COV, POSITION_NOISE_COV
    peer.H = positions(np.eye(n)).T
    means, covs, _, _ = filterpy_history(peer, track)
    smoothed, smoothed_covs, _, _ = peer.rts_smoother(means, covs)
    nothing = np.zeros((n, n))
    ways = [
        backward_affine(Gaussian(mean, cov), Affine(CRUISE @ mean, CRUISE, nothing), peer.Q)
        for mean, cov in zip(means[:-1], covs[:-1], strict=True)
    ]
    ours = smooth(Gaussian(means, covs), ways)
    for step in range(len(track)):
        belief = Gaussian(ours.mean[step], ours.cov[step])
        assert_close(belief, smoothed[step], smoothed_covs[step], 1e-9)


def filterpy_history(peer, track):
    """Means and covariances after each measurement, and before it."""
    kept = []
    for measurement in track:
        peer.predict()
        before = peer.x.copy(), peer.P.copy()
        peer.update(measurement)
        kept.append((peer.x.copy(), peer.P.copy(), *before))
    return tuple(np.array(part) for part in zip(*kept, strict=True))


def stone_soup_beliefs(start, transition_model, measurement_model, measurements):
    """The peer's means (n,) and covariances (n, n) after each measurement."""
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    n = len(start.mean)
    weights = {"alpha": 1.0, "beta": 2.0, "kappa": 3.0 - n}
    predictor = UnscentedKalmanPredictor(transition_model, **weights)
    updater = UnscentedKalmanUpdater(measurement_model, **weights)
    state = GaussianState(start.mean[:, None], start.cov, timestamp=START_TIME)
    for step, measurement in enumerate(measurements, start=1):
        now = START_TIME + timedelta(seconds=step)
        prediction = predictor.predict(state, timestamp=now)
        detection = Detection(measurement, timestamp=now, measurement_model=measurement_model)
        state = updater.update(SingleHypothesis(prediction, detection))
        assert isinstance(state, GaussianState)
        yield np.asarray(state.mean, dtype=float).ravel(), np.asarray(state.covar, dtype=float)


def test_stone_soup_agrees_on_a_turn_up_to_its_circular_mean():
    """It averages bearings on the circle, we average their residuals: equal to third order."""
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.models.transition.nonlinear import ConstantTurn
    from stonesoup.types.angle import Bearing
    from stonesoup.types.array import StateVector

    track = turn_track(np.random.default_rng(8), STEPS)
    peers = stone_soup_beliefs(
        TURN_START,
        ConstantTurn(linear_noise_coeffs=[0.05, 0.05], turn_noise_coeff=1e-6),
        CartesianToBearingRange(
            ndim_state=5,
            mapping=(0, 2),
            noise_covar=RANGE_BEARING_NOISE_COV[::-1, ::-1],
            translation_offset=SENSOR_POSITION_M[:, None],
        ),
        [StateVector([Bearing(bearing), distance]) for distance, bearing in track],
    )
    for belief, (mean, cov) in zip(our_turn(track), peers, strict=True):
        assert_close(belief, mean, cov, 1e-5)
