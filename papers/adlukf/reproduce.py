"""`concord reproduce adlukf`: the adaptive dual-layer UKF, on a car whose truth is independent.

Source: Wang, Liu and Cui, Vehicle state estimation based on an adaptive dual-layer unscented Kalman
filter. Its equations were lost and are reconstructed (docs/papers/adlukf.md). The CommonRoad
multi-body model takes the place of its simulator.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from concord.features.vehicle.plant import manoeuvres
from concord.features.vehicle.plant.model import linear_tyre, tanh_tyre
from concord.features.vehicle.plant.parameters import BMW_320I
from concord.features.vehicle.plant.truth import BMW, simulate
from concord.features.vehicle.plant.tyre_identification import identify
from concord.papers.adlukf import sections
from concord.papers.adlukf.claims import ERRATA, claims, gather
from concord.papers.adlukf.drives import drive_elsewhere, estimates, log_drives
from concord.papers.adlukf.figures import DPI, StateTrace, drives_figure, manoeuvre_figure
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.sections import COMPARED
from concord.papers.adlukf.study import (
    CASES,
    DRIVEN,
    MANOEUVRES,
    STATES,
    TIME_STEP_S,
    UNITS,
    ManoeuvreStudy,
    SmallAngles,
    average_nees,
    build_study,
    costs,
    estimate,
    matched_study,
    quantities,
    score,
    small_angles,
)
from concord.papers.kit.figures import save, write_traces
from concord.papers.kit.report import Paper, Section
from concord.papers.kit.side_by_side import by_name

SHOWN_CASES = ("true R", "2 I")
"""Of Figures 4 and 5."""


def _sections(folder: Path, seed: int, seeds: int) -> Iterator[Section]:
    drives = tuple(simulate(manoeuvres.MANOEUVRES[n], BMW, TIME_STEP_S) for n in DRIVEN)
    study = build_study(drives, tuple(CASES.values()), seeds, seed)
    yield sections.set_up(drives, seeds)
    means = by_name("adlukf", partial(_means, study), CONTESTANTS)
    truth = quantities(study.truth)
    results = {name: score(study, mean) for name, mean in means.items()}
    # Of the first seed, and mean absolute errors over the seeds: (steps, manoeuvres, cases, 4).
    traces = {name: quantities(mean[:, :, :, 0]) for name, mean in means.items()}
    errors = {n: np.abs(quantities(mean) - truth).mean(axis=3) for n, mean in means.items()}
    failed = {n: int((~np.isfinite(m).all(axis=(0, -1))).sum()) for n, m in means.items()}
    largest = np.abs(means["UKF"] - means["CKF"]).max(axis=(0, 1, 3, 4))
    ukf_minus_ckf = dict(zip(CASES, largest.tolist(), strict=True))
    _write(folder, truth[:, :, 0, 0], traces, errors)
    true_r = list(CASES).index("true R")
    # Over time (manoeuvres, 4), of the estimates of the first seed.
    signal_sd = {name: traces[name][1:, :, true_r].std(axis=0) for name in COMPARED}
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
    yield sections.ablations(results, ukf_minus_ckf)
    evidence = gather(results, drives, signal_sd, of_filters, failed)
    yield Section(25, "Claims", claims=claims(evidence), shown=True)
    yield Section(27, "Errata", errata=ERRATA)
    ramp = simulate(manoeuvres.MANOEUVRES["ramp-steer"], BMW, TIME_STEP_S)
    better = identify(ramp, BMW_320I, tanh_tyre, seek_friction=True, model=SmallAngles)
    saturating = small_angles(better.car, tanh_tyre, TIME_STEP_S, study.model.noise_cov)
    improved = {
        name: score(study, estimate(study, CONTESTANTS[name], saturating).mean)
        for name in ("CKF", "ADLUKF")
    }
    yield sections.better_model(results, improved, better)
    yield _figures_4_and_5(folder, truth[:, :, 0, 0], traces, errors)
    yield _figure_9(folder, seed)
    others = drive_elsewhere(seeds, seed)
    yield sections.elsewhere(others)
    yield sections.in_plain_words(results, consistency, ukf_minus_ckf, others)


def _means(study: ManoeuvreStudy, name: str) -> np.ndarray:
    return estimate(study, CONTESTANTS[name]).mean


def _figure_9(folder: Path, seed: int) -> Section:
    logged = log_drives(folder, seed)
    linear, tanh = logged.linear.car, logged.tanh.car
    traces = []
    of_models: dict[str, dict[str, np.ndarray]] = {}
    for name, title in zip(DRIVEN, MANOEUVRES, strict=True):
        drive, guess = logged.drives[name]
        models = {
            "a guess of 100 kN/rad per axle": (guess, linear_tyre),
            "identified, linear": (linear, linear_tyre),
            "identified, saturating": (tanh, tanh_tyre),
        }
        of_models[name] = {
            what: estimates(drive, *model, ("CKF",))["CKF"] for what, model in models.items()
        }
        shown = estimates(drive, linear, linear_tyre, COMPARED)
        traces.append(StateTrace(title, drive.time_s, quantities(drive.states), shown, {}))
    save(drives_figure("Figure 9 in form: logged drives", tuple(traces)), folder, "figure-9", DPI)
    return sections.logged_drives(logged, of_models, traces)


Traces = dict[str, np.ndarray]


def _figures_4_and_5(folder: Path, truth: np.ndarray, traces: Traces, errors: Traces) -> Section:
    time_s = TIME_STEP_S * np.arange(len(truth), dtype=np.float64)
    text = ["One seed; the two lowest rows are means over all seeds."]
    for manoeuvre, name in enumerate(MANOEUVRES):
        number = 4 + manoeuvre
        shown = []
        for case in SHOWN_CASES:
            at = list(CASES).index(case)
            lines = ({n: of[n][:, manoeuvre, at] for n in COMPARED} for of in (traces, errors))
            shown.append(StateTrace(CASES[case].what, time_s, truth[:, manoeuvre], *lines))
        figure = manoeuvre_figure(f"Figure {number} in form: {name}", tuple(shown))
        file = save(figure, folder, f"figure-{number}", DPI)
        text.append(f"![{file}]({file})")
    return Section(110, "Figures 4 and 5", "\n\n".join(text))


def _write(folder: Path, truth: np.ndarray, traces: Traces, errors: Traces) -> None:
    by_filter = ("filter", "step", "manoeuvre", "case", "quantity")
    write_traces(
        folder,
        {
            "truth": (("step", "manoeuvre", "quantity"), truth),
            "estimate": (by_filter, np.stack(list(traces.values()))),
            "mean_absolute_error": (by_filter, np.stack(list(errors.values()))),
        },
        {
            "filter": list(traces), "manoeuvre": list(DRIVEN), "case": list(CASES),
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
