"""`concord reproduce adlukf`: the adaptive dual-layer UKF, on a car whose truth is independent.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter. Its equations were lost and are reconstructed (docs/vehicle.md); the place of its simulator
takes the CommonRoad multi-body model.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import reproduce_adlukf_sections as sections
from experiments import reproduce_adlukf_verdict as verdict
from experiments.progress import progress
from experiments.reproduce_adlukf_consistency import average_nees, matched_study
from experiments.reproduce_adlukf_cost import costs
from experiments.reproduce_adlukf_drives import DRIVEN, estimates, log_drives
from experiments.reproduce_adlukf_elsewhere import drive_elsewhere, elsewhere
from experiments.reproduce_adlukf_figures import Trace, draw_drives, draw_manoeuvre
from experiments.reproduce_adlukf_filters import CONTESTANTS
from experiments.reproduce_adlukf_study import (
    CASES,
    TIME_STEP_S,
    Study,
    build_study,
    estimate,
    quantities,
    score,
)
from experiments.reproduce_adlukf_tables import COMPARED, Results, case_index
from experiments.reproduce_report import Reproduction, Section
from nodes.messages import Array
from plants.tyre_identification import identify
from plants.vehicle_manoeuvres import MANOEUVRES
from plants.vehicle_model import linear_tyre, single_track, tanh_tyre
from plants.vehicle_parameters import BMW_320I
from plants.vehicle_truth import BMW, simulate

SEED = 8
SEEDS = 20
SHOWN_CASES = ("true R", "2 I")
"""Of Figures 4 and 5."""


class Outcome(NamedTuple):
    """What the filters did: scores, traces of the first seed (steps, manoeuvres, cases, 4), mean
    absolute errors over the seeds likewise, lanes that failed, and the largest difference between
    UKF and CKF by case."""

    results: Results
    traces: dict[str, Array]
    errors: dict[str, Array]
    failed_lanes: dict[str, int]
    ukf_minus_ckf: dict[str, float]


def reproduction(seeds: int = SEEDS) -> Reproduction:
    """The reproduction with so many seeds.

    Raises:
        ValueError: fewer than two seeds, of which no interval can be made.
    """
    if seeds < 2:
        raise ValueError(f"--seeds {seeds}: an interval needs at least 2; use --seeds {SEEDS}")
    return Reproduction(
        "Adaptive dual-layer UKF for vehicle states (Wang, Liu, Cui): what holds",
        SEED,
        partial(_sections, seeds),
    )


def _sections(seeds: int, folder: Path) -> Iterator[Section]:
    drives = tuple(simulate(MANOEUVRES[name], BMW, TIME_STEP_S) for name in DRIVEN)
    study = build_study(drives, tuple(CASES.values()), seeds, SEED)
    yield sections.set_up(drives, seeds)
    outcome = _run(study)
    results = outcome.results
    yield sections.table_2(results, drives)
    yield sections.errors(results)
    yield sections.sensitivity(results)
    yield sections.other_noise(results)
    yield sections.spread(results, {name: _signal_sd(outcome, name) for name in COMPARED})
    matched = matched_study(drives[0], study.model, seeds, SEED)
    consistency = {name: average_nees(matched, c) for name, c in CONTESTANTS.items()}
    yield sections.consistency(consistency)
    yield sections.cost(costs(study))
    yield sections.ablations(results, outcome.ukf_minus_ckf, outcome.failed_lanes)
    better = identify(
        simulate(MANOEUVRES["ramp-steer"], BMW, TIME_STEP_S),
        BMW_320I,
        tanh_tyre,
        seek_friction=True,
    )
    saturating = single_track(better.car, tanh_tyre, TIME_STEP_S, study.model.noise_cov)
    improved = {
        name: score(study, estimate(study, CONTESTANTS[name], saturating).mean)
        for name in ("CKF", "ADLUKF")
    }
    yield verdict.better_model(results, improved, better)
    yield _figures(study, outcome, folder)
    logged = log_drives(folder, SEED)
    traces = []
    of_models: dict[str, dict[str, Array]] = {}
    for name in DRIVEN:
        drive, guess = logged.drives[name]
        of_models[name] = {
            "a guess of 100 kN/rad per axle": estimates(drive, guess, linear_tyre, ("CKF",))["CKF"],
            "identified, linear": estimates(drive, logged.linear.car, linear_tyre, ("CKF",))["CKF"],
            "identified, saturating": estimates(drive, logged.tanh.car, tanh_tyre, ("CKF",))["CKF"],
        }
        shown = estimates(drive, logged.linear.car, linear_tyre, COMPARED)
        reference = quantities(drive.states)
        traces.append(Trace(name.replace("-", " "), drive.time_s, reference, shown, {}))
    draw_drives(folder / "figure-9.png", "Figure 9 in form: logged drives", tuple(traces))
    yield verdict.logged_drives(logged, of_models, {t.title: t for t in traces})
    others = drive_elsewhere(seeds, SEED)
    yield elsewhere(others)
    yield verdict.in_plain_words(results, consistency, outcome.ukf_minus_ckf, others)


def _run(study: Study) -> Outcome:
    scores, traces, errors, failed = {}, {}, {}, {}
    truth = quantities(study.truth)
    means: dict[str, Array] = {}
    with progress("adlukf", len(CONTESTANTS)) as on_step:
        for number, (name, contestant) in enumerate(CONTESTANTS.items(), start=1):
            mean = estimate(study, contestant).mean
            scores[name] = score(study, mean)
            traces[name] = quantities(mean[:, :, :, 0])
            errors[name] = np.abs(quantities(mean) - truth).mean(axis=3)
            failed[name] = int((~np.isfinite(mean).all(axis=(0, -1))).sum())
            if name in ("UKF", "CKF"):
                means[name] = mean
            on_step(number)
    largest = np.abs(means["UKF"] - means["CKF"]).max(axis=(0, 1, 3, 4))
    difference = dict(zip(CASES, largest.tolist(), strict=True))
    return Outcome(scores, traces, errors, failed, difference)


def _signal_sd(outcome: Outcome, name: str) -> Array:
    """Standard deviation over time (manoeuvres, 4) of what a filter estimates, first seed."""
    return outcome.traces[name][1:, :, case_index("true R")].std(axis=0)


def _figures(study: Study, outcome: Outcome, folder: Path) -> Section:
    time_s = TIME_STEP_S * np.arange(len(study.truth), dtype=np.float64)
    files = []
    for number, (manoeuvre, name) in zip((4, 5), enumerate(DRIVEN), strict=True):
        traces = tuple(
            Trace(
                CASES[case].what,
                time_s,
                quantities(study.truth[:, manoeuvre, 0, 0]),
                {n: outcome.traces[n][:, manoeuvre, case_index(case)] for n in COMPARED},
                {n: outcome.errors[n][:, manoeuvre, case_index(case)] for n in COMPARED},
            )
            for case in SHOWN_CASES
        )
        files.append(f"figure-{number}.png")
        title = f"Figure {number} in form: {name.replace('-', ' ')}"
        draw_manoeuvre(folder / files[-1], title, traces)
    return sections.figures(files)
