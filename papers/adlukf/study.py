"""The ADLUKF study: the model, two manoeuvres, wrong and right beliefs of the noise, many seeds.

All manoeuvres, cases and seeds are lanes of one batch (manoeuvres, cases, seeds), so every filter
runs once, and every filter sees the same noise.
"""

import time
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.model import (
    ACCELERATION as ACCELERATION_INPUT,
)
from concord.features.vehicle.plant.model import (
    MIN_SPEED_M_S,
    SIDE_SLIP,
    SPEED,
    YAW_RATE,
    SingleTrack,
    Tyre,
    axles_of,
    linear_tyre,
)
from concord.features.vehicle.plant.model import STEERING as STEERING_INPUT
from concord.features.vehicle.plant.parameters import BMW_320I, Car
from concord.features.vehicle.plant.sensors import TEST_CAR, draw_errors
from concord.filters.gaussian import Gaussian
from concord.filters.metrics import nees
from concord.filters.moments import Model
from concord.papers.adlukf.filters import CONTESTANTS, Contestant, StepInput
from concord.results.figures.intervals import Interval, ratio_t

DRIVEN = ("double-lane-change", "serpentine")
MANOEUVRES = tuple(name.replace("-", " ") for name in DRIVEN)
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


@dataclass(frozen=True, eq=False)
class SmallAngles(SingleTrack):
    """The paper's 3-DOF model (its references 21 and 22): the first order of the angles.

    Attributes as `SingleTrack`.
    """

    def transition(self, state: np.ndarray, control: np.ndarray | None, step: int) -> np.ndarray:
        """State (..., 3) one step later under control (..., 2)."""
        assert control is not None, "a car is driven: give steering and acceleration"
        car = self.car
        yaw_rate, side_slip, speed = (state[..., i] for i in range(3))
        front, rear = self.axle_forces(state, control[..., STEERING_INPUT])
        moment = car.front_axle_m * front - car.rear_axle_m * rear
        forward = np.maximum(speed, MIN_SPEED_M_S)
        after = np.empty_like(state)
        after[..., YAW_RATE] = yaw_rate + self.time_step_s * moment / car.yaw_inertia_kg_m2
        turning = (front + rear) / (car.mass_kg * forward) - yaw_rate
        after[..., SIDE_SLIP] = side_slip + self.time_step_s * turning
        driving = yaw_rate * side_slip * speed + control[..., ACCELERATION_INPUT]
        after[..., SPEED] = speed + self.time_step_s * driving
        return after

    def axle_slips(self, state: np.ndarray, steering: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slip angles (...) of front and rear axle in rad."""
        turn = state[..., YAW_RATE] / np.maximum(state[..., SPEED], MIN_SPEED_M_S)
        front = state[..., SIDE_SLIP] + self.car.front_axle_m * turn - steering
        return front, state[..., SIDE_SLIP] - self.car.rear_axle_m * turn

    def accelerations(
        self, state: np.ndarray, control: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations (...) of the centre of mass: lateral, m/s^2, and of the yaw, rad/s^2."""
        front, rear = self.axle_forces(state, control[..., STEERING_INPUT])
        moment = self.car.front_axle_m * front - self.car.rear_axle_m * rear
        return (front + rear) / self.car.mass_kg, moment / self.car.yaw_inertia_kg_m2


def small_angles(
    car: Car, tyre: Tyre, time_step_s: float, noise_cov: np.ndarray | None = None
) -> SmallAngles:
    """Return the paper's model of a car; without process noise of its own unless that is given."""
    noise_cov = np.zeros((3, 3)) if noise_cov is None else noise_cov
    return SmallAngles(car, axles_of(car), tyre, time_step_s, noise_cov)


# --- manoeuvres, cases and seeds -----------------------------------------------------------------


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
        update, memory = contestant.step(belief, memory, task)
        belief = means[k], covs[k] = update.belief
    return Gaussian(means, covs)


STATES = ("v_x", "v_y", "side slip", "yaw rate")
UNITS = ("m/s", "m/s", "deg", "deg/s")
JUDGED = ("v_x", "side slip", "yaw rate")
"""The states of the filters; v_y follows from them."""


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


ScoresByFilter = dict[str, ErrorScores]
"""The scores of every filter by name."""


def each_seed(scores: ErrorScores, measure: str, state: str, case: str = "true R") -> np.ndarray:
    """One measure ("mae", "rmse" or "sd") of a state in a case: (manoeuvres, seeds)."""
    values: np.ndarray = getattr(scores, measure)
    return values[:, list(CASES).index(case), :, STATES.index(state)]


def ratio(results: ScoresByFilter, name: str, manoeuvre: int, state: str) -> Interval:
    """RMSE with R0 = 2 I over RMSE with R0 = 0.01 I, pooled over the seeds."""
    high, low = (each_seed(results[name], "rmse", state, case) for case in ("2 I", "0.01 I"))
    return ratio_t(high[manoeuvre] ** 2, low[manoeuvre] ** 2)


def over_ckf(
    results: ScoresByFilter, name: str, manoeuvre: int, state: str, case: str = "true R"
) -> Interval:
    """RMSE of a filter over the CKF's in the same case, pooled over the seeds."""
    ours, reference = (each_seed(results[n], "rmse", state, case) for n in (name, "CKF"))
    return ratio_t(ours[manoeuvre] ** 2, reference[manoeuvre] ** 2)


# --- consistency, on data that obey the filters' model exactly -----------------------------------


def matched_study(drive: Drive, model: SingleTrack, seeds: int, seed: int) -> ManoeuvreStudy:
    """Cars that move as the model says, with its process noise, under the steering of a drive."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    start = np.broadcast_to(drive.states[0], (seeds, 3))
    factor = np.linalg.cholesky(model.process_noise_cov(0))
    truth = [start]
    for k in range(drive.steps - 1):
        moved = model.transition(truth[-1], drive.inputs[k], k)
        truth.append(moved + generator.standard_normal((seeds, 3)) @ factor.T)
    states = np.array(truth)
    std = np.array([error.std for error in CHANNELS.values()])
    exact = np.stack(
        [model.measure(state, control) for state, control in zip(states, drive.inputs, strict=True)]
    )
    readings = exact + std * generator.standard_normal(exact.shape)
    error = generator.standard_normal((seeds, 3)) @ np.linalg.cholesky(PRIOR_COV).T
    lane = (slice(None), None, None)
    return ManoeuvreStudy(
        model=model,
        cases=(NoiseCase("matched", "the model is exact"),),
        controls=drive.inputs[:, None, None, None],
        measurements=readings[lane],
        believed=np.broadcast_to(std**2, (1, 1, seeds, 3)),
        start=(start + error)[None, None],
        truth=states[lane],
    )


def average_nees(study: ManoeuvreStudy, contestant: Contestant) -> np.ndarray:
    """Mean of e' P^-1 e over all steps but the first, per seed (seeds,); 3 is consistent."""
    belief = estimate(study, contestant)
    return nees(belief.mean - study.truth, belief.cov)[1:].mean(axis=0)[0, 0]


# --- cost ----------------------------------------------------------------------------------------

_TIMED_STEPS = 300


class FilterCost(NamedTuple):
    """Sigma points that went through a model in a step, and seconds per step."""

    evaluations: float
    seconds: float


def costs(study: ManoeuvreStudy) -> dict[str, FilterCost]:
    """The cost of every filter on one lane of a study.

    The time is the least of three runs, and belongs to this machine.
    """
    return {name: _cost(study, contestant) for name, contestant in CONTESTANTS.items()}


def _cost(study: ManoeuvreStudy, contestant: Contestant) -> FilterCost:
    points = 0

    def counted(model: Model, states: np.ndarray) -> np.ndarray:
        nonlocal points
        points += states.size // states.shape[-1]
        return model(states)

    def run(wrap: bool) -> float:
        belief = Gaussian(study.start[0, 0, 0], PRIOR_COV)
        Q = study.model.process_noise_cov(0)
        memory = contestant.begin(Q, study.believed[0, 0, 0])
        started = time.perf_counter()
        for k in range(1, _TIMED_STEPS + 1):
            f = partial(study.model.transition, control=study.controls[k - 1, 0, 0, 0], step=k - 1)
            h = partial(study.model.measure, control=study.controls[k, 0, 0, 0])
            if wrap:
                f, h = partial(counted, f), partial(counted, h)
            task = StepInput(f, h, study.measurements[k, 0, 0, 0], Q)
            update, memory = contestant.step(belief, memory, task)
            belief = update.belief
        assert np.isfinite(belief.mean).all(), f"{contestant.name} failed while it was timed"
        return (time.perf_counter() - started) / _TIMED_STEPS

    run(wrap=True)
    return FilterCost(points / _TIMED_STEPS, min(run(wrap=False) for _ in range(3)))
