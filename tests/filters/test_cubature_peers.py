"""The cubature filter against filterpy and Stone Soup; both, and the UKF, on a car as well."""

from datetime import datetime, timedelta
from functools import partial

import numpy as np

from concord.features.vehicle.plant.model import linear_tyre, single_track
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.filters import ukf
from concord.filters.gaussian import Gaussian
from concord.filters.sigma_points import cubature
from tests.filters.support import (
    TURN_NOISE_COV,
    TURN_START,
    turn,
)

START_TIME = datetime(2020, 1, 1)
CAR = single_track(BMW_320I, linear_tyre, 0.01, np.diag([1e-5, 1e-8, 1e-5]))
CAR_NOISE_COV = np.diag([0.1, 0.005, 0.1]) ** 2
CAR_START = Gaussian(np.array([0.05, 0.002, 20.0]), np.diag([1e-3, 1e-4, 0.25]))
CONTROLS = np.stack(
    [0.04 * np.sin(0.05 * np.arange(60)), 0.5 * np.cos(0.1 * np.arange(60))], axis=-1
)


def car_track() -> np.ndarray:
    """Readings (60, 3) of a car that moves as the model says."""
    generator = np.random.default_rng(4)
    state, readings = CAR_START.mean, []
    for control in CONTROLS:
        readings.append(CAR.measure(state, control) + generator.normal(0, [0.1, 0.005, 0.1]))
        state = CAR.transition(state, control, 0)
    return np.array(readings)


def assert_close(ours: Gaussian, mean, cov, tolerance: float) -> None:
    """Relative to the deviations that the filter reports."""
    deviations = np.sqrt(np.diagonal(ours.cov))
    assert (np.abs(ours.mean - mean) < tolerance * deviations).all()
    assert (np.abs(ours.cov - cov) < tolerance * np.outer(deviations, deviations)).all()


def our_drive(rule):
    belief = CAR_START
    for reading, control in zip(car_track(), CONTROLS, strict=True):
        measure = partial(CAR.measure, control=control)
        belief = ukf.update(belief, reading, measure, CAR_NOISE_COV, rule).belief
        yield belief
        transition = partial(CAR.transition, control=control, step=0)
        belief = ukf.predict(belief, transition, CAR.noise_cov, rule)


def test_filterpys_cubature_filter_agrees_on_a_car():
    from filterpy.kalman import CubatureKalmanFilter
    from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas

    peer = CubatureKalmanFilter(
        3,
        3,
        0.01,
        hx=lambda x, control: CAR.measure(x, control),
        fx=lambda x, dt, control: CAR.transition(x, control, 0),
    )
    peer.x, peer.P = CAR_START.mean[:, None], CAR_START.cov
    peer.Q, peer.R = CAR.noise_cov, CAR_NOISE_COV
    for reading, control, belief in zip(car_track(), CONTROLS, our_drive(cubature(3)), strict=True):
        # It keeps the points of the prediction, which lack the process noise; we draw them anew.
        peer.sigmas_f = spherical_radial_sigmas(peer.x, peer.P)
        peer.update(reading[:, None], hx_args=(control,))
        # Its covariance is a difference of squares of the speed: 400 of 1e-5.
        assert_close(belief, peer.x[:, 0], peer.P, 1e-5)
        peer.predict(fx_args=(control,))


def test_stone_soups_cubature_filter_agrees_on_a_turn():
    """Positions are measured: it would average bearings on the circle, we average residuals."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.nonlinear import ConstantTurn
    from stonesoup.predictor.kalman import CubatureKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import CubatureKalmanUpdater

    noise_cov = np.diag([4.0, 9.0])
    model = LinearGaussian(ndim_state=5, mapping=(0, 2), noise_covar=noise_cov)
    predictor = CubatureKalmanPredictor(
        ConstantTurn(linear_noise_coeffs=[0.05, 0.05], turn_noise_coeff=1e-6)
    )
    updater = CubatureKalmanUpdater(model)
    state = GaussianState(TURN_START.mean[:, None], TURN_START.cov, timestamp=START_TIME)
    rule, belief, true = cubature(5), TURN_START, TURN_START.mean
    generator = np.random.default_rng(8)
    for step in range(1, 11):
        true = turn(true)
        reading = true[[0, 2]] + generator.normal(0, [2.0, 3.0])
        belief = ukf.predict(belief, turn, TURN_NOISE_COV, rule)
        belief = ukf.update(belief, reading, lambda x: x[..., [0, 2]], noise_cov, rule).belief
        now = START_TIME + timedelta(seconds=step)
        detection = Detection(reading[:, None], timestamp=now, measurement_model=model)
        hypothesis = SingleHypothesis(predictor.predict(state, timestamp=now), detection)
        state = updater.update(hypothesis)
        assert isinstance(state, GaussianState)
        mean, cov = np.asarray(state.mean, float).ravel(), np.asarray(state.covar, float)
        # Its covariances are differences of squares of the position.
        assert_close(belief, mean, cov, 1e-7)
