"""`concord reproduce adlukf`: the adaptive dual-layer UKF, on a car whose truth is independent.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter. Its equations were lost and are reconstructed (docs/papers/adlukf.md). The CommonRoad
multi-body model takes the place of its simulator.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.manoeuvres import MANOEUVRES
from concord.features.vehicle.plant.model import linear_tyre, tanh_tyre
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.features.vehicle.plant.truth import BMW, simulate
from concord.features.vehicle.plant.tyre_identification import identify
from concord.papers.adlukf import sections, verdict
from concord.papers.adlukf.claims import claims, errata, gather
from concord.papers.adlukf.consistency import average_nees, matched_study
from concord.papers.adlukf.cost import costs
from concord.papers.adlukf.drives import DRIVEN, estimates, log_drives
from concord.papers.adlukf.elsewhere import drive_elsewhere, elsewhere
from concord.papers.adlukf.figures import DPI, StateTrace, drives_figure, manoeuvre_figure
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.small_angles import SmallAngles, small_angles
from concord.papers.adlukf.study import (
    CASES,
    STATES,
    TIME_STEP_S,
    UNITS,
    ManoeuvreStudy,
    build_study,
    estimate,
    quantities,
    score,
)
from concord.papers.adlukf.tables import COMPARED, ScoresByFilter, case_index
from concord.papers.kit.figures import save
from concord.papers.kit.report import Paper, Section
from concord.papers.kit.side_by_side import side_by_side
from concord.papers.kit.traces import write_traces

SHOWN_CASES = ("true R", "2 I")
"""Of Figures 4 and 5."""


class FilterResults(NamedTuple):
    """Results of the filters.

    traces: of the first seed, (steps, manoeuvres, cases, 4). Mean absolute errors over the seeds
    have the same shape. Further: the scores, the lanes that failed, and the largest difference
    between UKF and CKF by case.
    """

    results: ScoresByFilter
    traces: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    failed_lanes: dict[str, int]
    ukf_minus_ckf: dict[str, float]


def _sections(folder: Path, seed: int, seeds: int) -> Iterator[Section]:
    drives = tuple(simulate(MANOEUVRES[name], BMW, TIME_STEP_S) for name in DRIVEN)
    study = build_study(drives, tuple(CASES.values()), seeds, seed)
    yield sections.set_up(drives, seeds)
    outcome = _run(study)
    _write(study, outcome, folder)
    results = outcome.results
    signal_sd = {name: _signal_sd(outcome, name) for name in COMPARED}
    yield sections.table_2(results)
    yield sections.errors(results)
    yield sections.sensitivity(results)
    yield sections.other_noise(results)
    yield sections.spread(results, signal_sd)
    matched = matched_study(drives[0], study.model, seeds, seed)
    consistency = {name: average_nees(matched, c) for name, c in CONTESTANTS.items()}
    yield sections.consistency(consistency)
    of_filters = costs(study)
    yield sections.cost(of_filters)
    yield sections.ablations(results, outcome.ukf_minus_ckf)
    evidence = gather(results, drives, signal_sd, of_filters, outcome.failed_lanes)
    yield Section(25, "Claims", claims=claims(evidence), shown=True)
    yield Section(27, "Errata", errata=errata())
    better = identify(
        simulate(MANOEUVRES["ramp-steer"], BMW, TIME_STEP_S),
        BMW_320I,
        tanh_tyre,
        seek_friction=True,
        model=SmallAngles,
    )
    saturating = small_angles(better.car, tanh_tyre, TIME_STEP_S, study.model.noise_cov)
    improved = {
        name: score(study, estimate(study, CONTESTANTS[name], saturating).mean)
        for name in ("CKF", "ADLUKF")
    }
    yield verdict.better_model(results, improved, better)
    yield _figures(study, outcome, folder)
    logged = log_drives(folder, seed)
    traces = []
    of_models: dict[str, dict[str, np.ndarray]] = {}
    for name in DRIVEN:
        drive, guess = logged.drives[name]
        of_models[name] = {
            "a guess of 100 kN/rad per axle": estimates(drive, guess, linear_tyre, ("CKF",))["CKF"],
            "identified, linear": estimates(drive, logged.linear.car, linear_tyre, ("CKF",))["CKF"],
            "identified, saturating": estimates(drive, logged.tanh.car, tanh_tyre, ("CKF",))["CKF"],
        }
        shown = estimates(drive, logged.linear.car, linear_tyre, COMPARED)
        reference = quantities(drive.states)
        traces.append(StateTrace(name.replace("-", " "), drive.time_s, reference, shown, {}))
    save(drives_figure("Figure 9 in form: logged drives", tuple(traces)), folder, "figure-9", DPI)
    yield verdict.logged_drives(logged, of_models, {t.title: t for t in traces})
    others = drive_elsewhere(seeds, seed)
    yield elsewhere(others)
    yield verdict.in_plain_words(results, consistency, outcome.ukf_minus_ckf, others)


def _run(study: ManoeuvreStudy) -> FilterResults:
    scores, traces, errors, failed = {}, {}, {}, {}
    truth = quantities(study.truth)
    means: dict[str, np.ndarray] = {}
    names = list(CONTESTANTS)
    for name, mean in zip(
        names, side_by_side("adlukf", partial(_means, study), names), strict=True
    ):
        scores[name] = score(study, mean)
        traces[name] = quantities(mean[:, :, :, 0])
        errors[name] = np.abs(quantities(mean) - truth).mean(axis=3)
        failed[name] = int((~np.isfinite(mean).all(axis=(0, -1))).sum())
        if name in ("UKF", "CKF"):
            means[name] = mean
    largest = np.abs(means["UKF"] - means["CKF"]).max(axis=(0, 1, 3, 4))
    difference = dict(zip(CASES, largest.tolist(), strict=True))
    return FilterResults(scores, traces, errors, failed, difference)


def _means(study: ManoeuvreStudy, name: str) -> np.ndarray:
    return estimate(study, CONTESTANTS[name]).mean


def _signal_sd(outcome: FilterResults, name: str) -> np.ndarray:
    """Standard deviation over time (manoeuvres, 4) of what a filter estimates, first seed."""
    return outcome.traces[name][1:, :, case_index("true R")].std(axis=0)


def _figures(study: ManoeuvreStudy, outcome: FilterResults, folder: Path) -> Section:
    time_s = TIME_STEP_S * np.arange(len(study.truth), dtype=np.float64)
    files = []
    for number, (manoeuvre, name) in zip((4, 5), enumerate(DRIVEN), strict=True):
        traces = tuple(
            StateTrace(
                CASES[case].what,
                time_s,
                quantities(study.truth[:, manoeuvre, 0, 0]),
                {n: outcome.traces[n][:, manoeuvre, case_index(case)] for n in COMPARED},
                {n: outcome.errors[n][:, manoeuvre, case_index(case)] for n in COMPARED},
            )
            for case in SHOWN_CASES
        )
        title = f"Figure {number} in form: {name.replace('-', ' ')}"
        files.append(save(manoeuvre_figure(title, traces), folder, f"figure-{number}", DPI))
    shown = [f"![{name}]({name})" for name in files]
    text = "One seed; the two lowest rows are means over all seeds.\n\n" + "\n\n".join(shown)
    return Section(110, "Figures 4 and 5", text)


def _write(study: ManoeuvreStudy, outcome: FilterResults, folder: Path) -> None:
    axes = ("step", "manoeuvre", "case", "quantity")
    by_filter = ("filter", *axes)
    write_traces(
        folder,
        {
            "truth": (("step", "manoeuvre", "quantity"), quantities(study.truth)[:, :, 0, 0]),
            "estimate": (by_filter, np.stack(list(outcome.traces.values()))),
            "mean_absolute_error": (by_filter, np.stack(list(outcome.errors.values()))),
        },
        {
            "filter": list(outcome.traces), "manoeuvre": list(DRIVEN), "case": list(CASES),
            "quantity": [f"{name} [{unit}]" for name, unit in zip(STATES, UNITS, strict=True)],
        },
    )  # fmt: skip


PAPER = Paper(
    "Adaptive dual-layer UKF for vehicle states (Wang, Liu, Cui): what holds",
    seed=8,
    runs=20,
    least_runs=2,
    because="seeds of the sensors' noise, so that an interval can be made",
    sections=_sections,
)
