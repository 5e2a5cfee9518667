"""Other drives: logged ones for Figure 9, and other cars and manoeuvres.

The paper drove a Volkswagen Santana and published no data. In its place this module
simulates a Ford Escort with 29 states and writes its drives as logs with sensor noise. From there
on it treats each log as a user's real drive: it reads the log, identifies the tyres and estimates
the states.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.drive_log import LoggedDrive, read_folder, write_drive
from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.model import Tyre, linear_tyre, tanh_tyre
from concord.features.vehicle.plant.parameters import Car
from concord.features.vehicle.plant.sensors import TEST_CAR, logged
from concord.features.vehicle.plant.truth import ESCORT, TRUE_CARS, data_sheet, simulate
from concord.features.vehicle.plant.tyre_identification import Identified, identify
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.study import (
    CASES,
    CHANNELS,
    DRIVEN,
    PROCESS_VARIANCES,
    START_ERROR,
    TIME_STEP_S,
    ManoeuvreStudy,
    SmallAngles,
    build_study,
    estimate,
    over_ckf,
    quantities,
    ratio,
    score,
    small_angles,
)
from concord.papers.kit.side_by_side import side_by_side

IDENTIFIED_FROM = "ramp-steer"
GUESS_N_RAD = 100e3
"""Stiffness of an axle that identification starts from, as if nothing were known."""


class Logged(NamedTuple):
    """Logged drives by manoeuvre, and what identification says of the car for either tyre."""

    drives: dict[str, LoggedDrive]
    linear: Identified
    tanh: Identified


def log_drives(folder: Path, seed: int) -> Logged:
    """Drive the Escort, write the logs below `folder`, read them again and identify the tyres."""
    sheet = data_sheet(ESCORT)
    guess = msgspec.structs.replace(
        sheet, front_stiffness_n_rad=GUESS_N_RAD, rear_stiffness_n_rad=GUESS_N_RAD
    )
    drives = {}
    for number, name in enumerate((*DRIVEN, IDENTIFIED_FROM)):
        truth = simulate(MANOEUVRES[name], ESCORT, TIME_STEP_S)
        place = folder / f"drive-{name}"
        place.mkdir()
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(9, number)))
        write_drive(place, logged(truth, TEST_CAR, generator), guess)
        drives[name] = read_folder(place)
    drive, car = drives[IDENTIFIED_FROM]
    return Logged(
        drives,
        identify(drive, car, linear_tyre, model=SmallAngles),
        identify(drive, car, tanh_tyre, seek_friction=True, model=SmallAngles),
    )


def estimates(
    drive: Drive, car: Car, tyre: Tyre, filters: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Return the estimates of each filter for one logged drive: `quantities` (steps, 4)."""
    model = small_angles(car, tyre, drive.time_step_s, np.diag(PROCESS_VARIANCES))
    readings = np.stack(
        [drive.lateral_acceleration_m_s2, drive.yaw_rate_rad_s, drive.speed_m_s], axis=-1
    )
    variances = np.array([error.std**2 for error in CHANNELS.values()])
    lane = (slice(None), None, None, None)
    study = ManoeuvreStudy(
        model=model,
        cases=(CASES["true R"],),
        controls=drive.inputs[lane],
        measurements=readings[lane],
        believed=np.broadcast_to(variances, (1, 1, 1, 3)),
        start=np.broadcast_to(np.array([0.0, 0.0, drive.speed_m_s[0]]) + START_ERROR, (1, 1, 1, 3)),
        truth=drive.states[lane],
    )
    run = partial(estimate, study)
    return {name: quantities(run(CONTESTANTS[name]).mean[:, 0, 0, 0]) for name in filters}


def side_slip_rmse_deg(drive: Drive, estimate_: np.ndarray) -> float:
    """RMSE against the logged side slip, from the second step on."""
    error = estimate_[1:, 2] - np.degrees(drive.side_slip_rad[1:])
    return float(np.sqrt(np.nanmean(error**2)))


# --- other cars and manoeuvres -------------------------------------------------------------------

ELSEWHERE = (
    ("bmw-320i", "step-steer"),
    ("bmw-320i", "sine-with-dwell"),
    ("bmw-320i", "braking-in-a-turn"),
    ("bmw-320i-soft", "serpentine"),
    *(("ford-escort", manoeuvre) for manoeuvre in DRIVEN),
    *(("vw-vanagon", manoeuvre) for manoeuvre in DRIVEN),
)
"""The car on soft tyres spins in the double lane change."""

_FILTERS = ("CKF", "AUKF", "ADLUKF", "ADLUKF printed")
_STATES = ("v_x", "yaw rate")


class Elsewhere(NamedTuple):
    """A drive, and by filter, of v_x and yaw rate each (2,): RMSE(2 I) / RMSE(0.01 I), and the RMSE
    over the CKF's with the true R."""

    title: str
    ratio: dict[str, np.ndarray]
    over_ckf: dict[str, np.ndarray]


def drive_elsewhere(seeds: int, seed: int) -> list[Elsewhere]:
    """The filters on every drive, each with the data sheet of its car and the same Q."""
    jobs = [(*where, seed + number) for number, where in enumerate(ELSEWHERE, start=1)]
    return side_by_side("other cars and manoeuvres", partial(_drive, seeds), jobs)


def _drive(seeds: int, job: tuple[str, str, int]) -> Elsewhere:
    car, manoeuvre, seed = job
    true_car = TRUE_CARS[car]
    drive = simulate(MANOEUVRES[manoeuvre], true_car, TIME_STEP_S)
    cases = tuple(CASES[name] for name in ("true R", "0.01 I", "2 I"))
    # Where `study.each_seed` looks for them.
    assert cases == tuple(CASES.values())[: len(cases)]
    study = build_study((drive,), cases, seeds, seed, data_sheet(true_car))
    results = {n: score(study, estimate(study, CONTESTANTS[n]).mean) for n in _FILTERS}
    return Elsewhere(
        f"{true_car.name}, {manoeuvre.replace('-', ' ')}",
        {n: np.array([ratio(results, n, 0, s).value for s in _STATES]) for n in _FILTERS},
        {n: np.array([over_ckf(results, n, 0, s).value for s in _STATES]) for n in _FILTERS},
    )
