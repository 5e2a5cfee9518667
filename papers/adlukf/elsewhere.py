"""Whether what holds of the ADLUKF holds on other cars and in other manoeuvres."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.truth import TRUE_CARS, data_sheet, simulate
from concord.papers.adlukf import tables
from concord.papers.adlukf.drives import DRIVEN
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.study import CASES, TIME_STEP_S, build_study, estimate, score
from concord.papers.kit.checks import below
from concord.papers.kit.report import Section, markdown_table
from concord.papers.kit.side_by_side import side_by_side

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
    # Where `tables.case_index` looks for them.
    assert cases == tuple(CASES.values())[: len(cases)]
    study = build_study((drive,), cases, seeds, seed, data_sheet(true_car))
    results = {n: score(study, estimate(study, CONTESTANTS[n]).mean) for n in _FILTERS}
    return Elsewhere(
        f"{true_car.name}, {manoeuvre.replace('-', ' ')}",
        {n: np.array([tables.ratio(results, n, 0, s) for s in _STATES]) for n in _FILTERS},
        {n: np.array([tables.over_ckf(results, n, 0, s) for s in _STATES]) for n in _FILTERS},
    )


def elsewhere(drives: Sequence[Elsewhere]) -> Section:
    """The same questions of other drives."""
    rows = [
        [
            drive.title,
            *(_cell(drive.ratio[name]) for name in ("CKF", "ADLUKF", "AUKF")),
            *(_cell(drive.over_ckf[name]) for name in ("ADLUKF", "ADLUKF printed")),
        ]
        for drive in drives
    ]
    head = [
        "v_x / yaw rate",
        *(f"{n}: RMSE(2 I) / RMSE(0.01 I)" for n in ("CKF", "ADLUKF", "AUKF")),
        *(f"{n} over CKF, true R" for n in ("ADLUKF", "ADLUKF printed")),
    ]
    text = f"""\
Three other cars, three other manoeuvres; sensors, filters and Q as before. Every filter has the
linear tyres of its car's data sheet.

{markdown_table(head, rows)}

{in_words(drives)} The shorter the drive, the more of it is the time in which R0 is forgotten."""
    checks = [
        below(
            f"worst ratio of the ADLUKF over that of the CKF, {drive.title}",
            drive.ratio["ADLUKF"].max() / drive.ratio["CKF"].max(),
            1.0,
        )
        for drive in drives
    ]
    return Section(105, "Other cars and manoeuvres", text, checks)


def in_words(drives: Sequence[Elsewhere]) -> str:
    """Return a paragraph that says which claims hold in these drives."""
    ours, reference = (np.array([drive.ratio[n] for drive in drives]) for n in ("ADLUKF", "CKF"))
    over = np.array([drive.over_ckf["ADLUKF"] for drive in drives])
    within = int((np.abs(ours - 1.0) <= 0.2).all(axis=1).sum())
    beats = int((over < 1.0).all(axis=1).sum())
    return (
        f"In {len(drives)} drives of other cars and in other manoeuvres the ADLUKF's ratios "
        f"RMSE(2 I) / RMSE(0.01 I) of v_x and yaw rate are {ours.min():.2f} to {ours.max():.2f} "
        f"(both within 0.8 and 1.2 in {within}), the CKF's {reference.min():.2f} to "
        f"{reference.max():.2f}; with the right R the ADLUKF beats the CKF in both states in "
        f"{beats}."
    )


def _cell(values: np.ndarray) -> str:
    return " / ".join(f"{value:.2f}" for value in values)
