"""The same filter step by filterpy, by Stone Soup and by a loop in C: seconds per step."""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from benchmarks.cases import SENSOR_POSITION_M, BenchmarkCase, beliefs, readings
from concord.filters.gaussian import Gaussian

FILTERPY_STEPS, STONE_SOUP_STEPS, C_LANES = 100, 30, 10_000


def filterpy_loop(case: BenchmarkCase) -> Callable[[], float]:
    """filterpy's UnscentedKalmanFilter with the same weights."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    n = len(case.start.mean)
    peer = UnscentedKalmanFilter(
        n,
        2,
        1.0,
        hx=case.measure_of_one,
        fx=case.transition_of_one,
        points=MerweScaledSigmaPoints(n, 1.0, 2.0, 3.0 - n),
        residual_z=case.residual_of_one,
    )
    peer.Q, peer.R = case.process_noise_cov, case.measurement_noise_cov
    reading = readings(case, ())

    def run() -> float:
        peer.x, peer.P = case.start.mean.copy(), case.start.cov.copy()
        started = time.thread_time()
        for _ in range(FILTERPY_STEPS):
            peer.predict()
            peer.update(reading)
        return (time.thread_time() - started) / FILTERPY_STEPS

    return run


def stone_soup_loop(case: BenchmarkCase) -> Callable[[], float]:
    """Stone Soup's unscented predictor and updater with its own models of the same case."""
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.models.transition.nonlinear import ConstantTurn
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    n, reading = len(case.start.mean), readings(case, ())
    noise = case.measurement_noise_cov
    if case.name == "A":
        moving = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.05)] * 2)
        seeing = LinearGaussian(n, (0, 2), noise)
    else:
        moving = ConstantTurn(linear_noise_coeffs=np.array([0.05, 0.05]), turn_noise_coeff=1e-6)
        offset = np.array(SENSOR_POSITION_M)[:, None]
        seeing = CartesianToBearingRange(n, (0, 2), noise[::-1, ::-1], translation_offset=offset)
        reading = reading[::-1]
    predictor, updater = UnscentedKalmanPredictor(moving), UnscentedKalmanUpdater(seeing)
    begin = datetime(2026, 1, 1)

    def run() -> float:
        state = GaussianState(case.start.mean[:, None], case.start.cov, begin)
        started = time.thread_time()
        for step in range(1, STONE_SOUP_STEPS + 1):
            seen = Detection(reading[:, None], timestamp=begin + timedelta(seconds=step))
            prediction = predictor.predict(state, timestamp=seen.timestamp)
            state = updater.update(SingleHypothesis(prediction, seen))
        return (time.thread_time() - started) / STONE_SOUP_STEPS

    return run


def c_loop(case: BenchmarkCase) -> Callable[[], float] | None:
    """A loop over filters in C, models included, built here; None without gcc."""
    gcc = shutil.which("gcc")
    if gcc is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "ukf_loop.so"
        source = Path(__file__).with_name("ukf_loop.c")
        flags = ["-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC"]
        subprocess.run([gcc, *flags, str(source), "-o", str(built), "-lm"], check=True)
        library = ctypes.CDLL(str(built))
    kernel = library.straight if case.name == "A" else library.turn
    arrays = [case.process_noise_cov, case.measurement_noise_cov, readings(case, (C_LANES,))]
    given = [np.ascontiguousarray(array).ctypes for array in arrays]

    def step(belief: Gaussian) -> None:
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in belief]
        kernel(C_LANES, *pointers, *(array.data_as(ctypes.c_void_p) for array in given))

    def run() -> float:
        belief = beliefs(case, (C_LANES,))
        started = time.thread_time()
        for _ in range(3):
            step(belief)
        return (time.thread_time() - started) / (3 * C_LANES)

    run.step = step  # type: ignore[attr-defined]
    return run
