"""The ADLUKF study: two manoeuvres, several wrong and right beliefs of the noise, many seeds.

All manoeuvres, cases and seeds are lanes of one batch (manoeuvres, cases, seeds), so every filter
runs once, and every filter sees the same noise.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import SingleTrack, linear_tyre
from concord.features.vehicle.plant.parameters import BMW_320I, Car
from concord.features.vehicle.plant.sensors import TEST_CAR, draw_errors
from concord.filters.gaussian import Gaussian
from concord.papers.adlukf.filters import Contestant, StepInput
from concord.papers.adlukf.small_angles import small_angles

TIME_STEP_S = 0.01
"""Of the paper's test car."""

STEERING = TEST_CAR["steering_rad"]
ACCELERATION = TEST_CAR["longitudinal_acceleration_m_s2"]
CHANNELS = {
    "lateral acceleration": TEST_CAR["lateral_acceleration_m_s2"],
    "yaw rate": TEST_CAR["yaw_rate_rad_s"],
    "speed": TEST_CAR["speed_m_s"],
}
"""The measurement z of the filters, in m/s^2, rad/s and m/s."""

PROCESS_VARIANCES = (1e-5, 1e-8, 1e-5)
"""Q per step of yaw rate, side slip and speed: the best of a grid for the CKF that knows R. Every
filter has it, so no filter but the CKF is favoured."""

PRIOR_COV = np.diag([1e-3, 1e-3, 0.25])
START_ERROR = np.array([0.0, 0.0, 0.3])

GROWTH = ((6.0, 4.0),)
"""From 6 s on the noise is four times as large."""


class NoiseCase(NamedTuple):
    """One case: the R that a filter assumes, and the true noise of the sensors.

    `believed` (3,) are the variances that the filters start with, None for the true ones.
    """

    name: str
    what: str
    believed: tuple[float, float, float] | None = None
    changes: tuple[tuple[float, float], ...] = ()
    outlier_share: float = 0.0
    lateral_only: bool = False


CASES = {
    case.name: case
    for case in (
        NoiseCase("true R", "R0 is the sensors' covariance"),
        NoiseCase("0.01 I", "R0 = 0.01 I", believed=(0.01, 0.01, 0.01)),
        NoiseCase("2 I", "R0 = 2 I", believed=(2.0, 2.0, 2.0)),
        NoiseCase(
            "growing", "R0 is right until the noise grows fourfold after 6 s", changes=GROWTH
        ),
        NoiseCase("outliers", "2 % of the readings with 20 times the noise", outlier_share=0.02),
        NoiseCase("a_y alone", "lateral acceleration is the only measurement", lateral_only=True),
    )
}


class ManoeuvreStudy(NamedTuple):
    """Input of the filters, (steps, manoeuvres, cases, seeds, ...), and the truth.

    controls and measurements have last axes 2 and 3; `believed` variances and `start`, where the
    filters begin, are (manoeuvres, cases, seeds, 3); `truth` (steps, manoeuvres, 1, 1 or seeds, 3).
    """

    model: SingleTrack
    cases: tuple[NoiseCase, ...]
    controls: np.ndarray
    measurements: np.ndarray
    believed: np.ndarray
    start: np.ndarray
    truth: np.ndarray

    @property
    def seeds(self) -> int:
        """How many."""
        return self.measurements.shape[3]


def build_study(
    drives: tuple[Drive, ...],
    cases: tuple[NoiseCase, ...],
    seeds: int,
    seed: int,
    car: Car = BMW_320I,
) -> ManoeuvreStudy:
    """The study of drives of equal length; noise from `seed`."""
    model = small_angles(car, linear_tyre, drives[0].time_step_s, np.diag(PROCESS_VARIANCES))
    controls, measurements = [], []
    for number, drive in enumerate(drives):
        stream = partial(_stream, seed, number)
        inputs = drive.inputs[:, None, :] + np.stack(
            [
                draw_errors(STEERING, stream("steering"), drive.time_s, seeds),
                draw_errors(ACCELERATION, stream("acceleration"), drive.time_s, seeds),
            ],
            axis=-1,
        )
        controls.append(inputs[:, None])
        measurements.append(np.stack([_measured(drive, c, stream, seeds) for c in cases], axis=1))
    true = tuple(error.std**2 for error in CHANNELS.values())
    believed = np.array([true if case.believed is None else case.believed for case in cases])
    truth = np.stack([drive.states for drive in drives], axis=1)[:, :, None, None]
    lanes = (len(drives), len(cases), seeds, 3)
    return ManoeuvreStudy(
        model=model,
        cases=cases,
        controls=np.stack(controls, axis=1),
        measurements=np.stack(measurements, axis=1),
        believed=np.broadcast_to(believed[:, None], lanes),
        start=np.broadcast_to(truth[0] + START_ERROR, lanes),
        truth=truth,
    )


def _stream(seed: int, drive: int, purpose: str) -> np.random.Generator:
    number = ("steering", "acceleration", *CHANNELS).index(purpose)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(drive, number)))


def _measured(drive: Drive, case: NoiseCase, stream: partial, seeds: int) -> np.ndarray:
    """Readings (steps, seeds, 3); the same normals in every case."""
    exact = np.stack(
        [drive.lateral_acceleration_m_s2, drive.yaw_rate_rad_s, drive.speed_m_s], axis=-1
    )
    errors = [
        draw_errors(
            error._replace(changes=case.changes, outlier_share=case.outlier_share),
            stream(name),
            drive.time_s,
            seeds,
        )
        for name, error in CHANNELS.items()
    ]
    readings = exact[:, None, :] + np.stack(errors, axis=-1)
    if case.lateral_only:
        readings[..., 1:] = np.nan
    return readings


def estimate(
    study: ManoeuvreStudy, contestant: Contestant, model: SingleTrack | None = None
) -> Gaussian:
    """Return a filter's beliefs: mean (steps, manoeuvres, cases, seeds, 3), cov likewise."""
    model = study.model if model is None else model
    belief = Gaussian(study.start, np.broadcast_to(PRIOR_COV, (*study.start.shape, 3)))
    Q = model.process_noise_cov(0)
    memory = contestant.begin(Q, study.believed)
    means = np.empty((len(study.measurements), *study.start.shape))
    covs = np.empty((*means.shape, 3))
    means[0], covs[0] = belief
    for k in range(1, len(means)):
        task = StepInput(
            partial(model.transition, control=study.controls[k - 1], step=k - 1),
            partial(model.measure, control=study.controls[k]),
            study.measurements[k],
            Q,
        )
        belief, memory = contestant.step(belief, memory, task)
        means[k], covs[k] = belief
    return Gaussian(means, covs)


STATES = ("v_x", "v_y", "side slip", "yaw rate")
UNITS = ("m/s", "m/s", "deg", "deg/s")


class ErrorScores(NamedTuple):
    """Errors from the second step on, by `STATES` in `UNITS`: (manoeuvres, cases, seeds, 4)."""

    mae: np.ndarray
    rmse: np.ndarray
    sd: np.ndarray


def quantities(states: np.ndarray) -> np.ndarray:
    """v_x, v_y, side slip and yaw rate (..., 4) of states (..., 3), in `UNITS`."""
    yaw_rate, side_slip, speed = (states[..., i] for i in range(3))
    lateral = speed * np.tan(side_slip)
    return np.stack([speed, lateral, np.degrees(side_slip), np.degrees(yaw_rate)], axis=-1)


def score(study: ManoeuvreStudy, means: np.ndarray) -> ErrorScores:
    """How good estimates (steps, manoeuvres, cases, seeds, 3) are."""
    errors = (quantities(means) - quantities(study.truth))[1:]
    return ErrorScores(
        np.abs(errors).mean(axis=0), np.sqrt((errors**2).mean(axis=0)), errors.std(axis=0)
    )
