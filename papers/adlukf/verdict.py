"""Compose the verdict on the ADLUKF from its figures, and compare it with a better model."""

from collections.abc import Mapping, Sequence

import numpy as np

from concord.features.vehicle.plant.tyre_identification import Identified
from concord.papers.adlukf import tables
from concord.papers.adlukf.claims import MANOEUVRES
from concord.papers.adlukf.drives import DRIVEN, IDENTIFIED_FROM, Logged, side_slip_rmse_deg
from concord.papers.adlukf.elsewhere import Elsewhere, in_words
from concord.papers.adlukf.figures import StateTrace
from concord.papers.adlukf.sections import SHOWN
from concord.papers.adlukf.tables import COMPARED, ScoresByFilter, case_index, state_index
from concord.papers.kit.checks import above, at_most, below
from concord.papers.kit.report import Section, markdown_table


def in_plain_words(
    results: ScoresByFilter,
    nees: Mapping[str, np.ndarray],
    ukf_minus_ckf: Mapping[str, float],
    others: Sequence[Elsewhere],
) -> Section:
    """Return the verdict. Each sentence that judges has its checks below."""
    lines = [
        "With the right R the ADLUKF does not win: "
        f"{_span(results, 'ADLUKF', 'true R')} times the CKF's RMSE.",
        f"In v_x and yaw rate it does with R0 = 2 I, {_span(results, 'ADLUKF', '2 I')}, and with "
        f"noise that grows fourfold, {_span(results, 'ADLUKF', 'growing')}; with R0 = 0.01 I in "
        f"the yaw rate alone, {_span(results, 'ADLUKF', '0.01 I')}. That merit is real, if R alone "
        "is adapted, in residual form, within absolute bounds.",
        "It is the adaptation's merit. The same adaptation on a plain UKF (AUKF) costs a fraction "
        f"and has {_span(results, 'AUKF', '2 I')} and {_span(results, 'AUKF', 'growing')}. What "
        "the inner layer adds is gain, which forgets a wrong start sooner: RMSE(2 I) / RMSE(0.01 I)"
        f" of v_x is {_worst_ratio(results, 'ADLUKF'):.2f} with it and "
        f"{_worst_ratio(results, 'AUKF'):.2f} without.",
        "The inner layer counts every reading twice: average NEES "
        f"{nees['DLUKF'].mean():.1f} instead of 3 (UKF {nees['UKF'].mean():.2f}). Made consistent "
        f"it gives the UKF back ({nees['DLUKF consistent'].mean():.2f}).",
        "The filter as printed (Q and R, |diag|) has "
        f"{_span(results, 'ADLUKF printed', 'true R')} at the right R; with the means q and r "
        f"{_span(results, 'ADLUKF printed, q r', 'true R')}.",
        "UKF and CKF are one filter here: with the right R no state differs by more than "
        f"{ukf_minus_ckf['true R']:.0e}, with R0 = 2 I by {ukf_minus_ckf['2 I']:.0e} (rad/s, rad, "
        "m/s).",
        "Adaptation takes outliers for noise: with 2 % of them the ADLUKF has "
        f"{_span(results, 'ADLUKF', 'outliers')}. Maximum correntropy ignores them: "
        f"{_span(results, 'MCUKF', 'outliers')}.",
        "The side slip hardly depends on the filter; its error is that of the tyre model.",
        in_words(others),
    ]
    text = "\n".join(f"{number}. {line}" for number, line in enumerate(lines, start=1))
    text += (
        "\n\nThree numbers in a row are the RMSE of v_x, side slip and yaw rate over the CKF's in "
        "the same case, the worse of the two manoeuvres. Sentences 1 to 8 are of one car in two "
        "manoeuvres; all of one simulator and one Q. Nothing is claimed beyond that.\n\n"
        + markdown_table(
            ["over the CKF", *_JUDGED_CASES],
            [[name, *(_span(results, name, case) for case in _JUDGED_CASES)] for name in SHOWN[1:]],
        )
    )
    checks = [
        above("ADLUKF over CKF at the true R, v_x", _worst(results, "ADLUKF", "true R", "v_x"), 1),
        *(
            below(f"{name} over CKF, {case}, {state}", _worst(results, name, case, state), 1)
            for name in ("ADLUKF", "AUKF")
            for case in ("2 I", "growing")
            for state in ("v_x", "yaw rate")
        ),
        below(
            "ADLUKF over CKF, 0.01 I, yaw rate", _worst(results, "ADLUKF", "0.01 I", "yaw rate"), 1
        ),
        above(
            "ADLUKF over CKF with outliers, v_x", _worst(results, "ADLUKF", "outliers", "v_x"), 1
        ),
        *(
            below(f"MCUKF over CKF with outliers, {state}", worst, 0.6)
            for state, worst in (
                (state, _worst(results, "MCUKF", "outliers", state))
                for state in ("v_x", "yaw rate")
            )
        ),
    ]
    return Section(10, "What holds, in plain words", text, checks, shown=True)


_JUDGED_CASES = ("true R", "0.01 I", "2 I", "growing", "outliers")


def _worst_ratio(results: ScoresByFilter, name: str) -> float:
    return max(tables.ratio(results, name, m, "v_x") for m in range(len(MANOEUVRES)))


def _worst(results: ScoresByFilter, name: str, case: str, state: str) -> float:
    """RMSE over the CKF's in the same case, the worse of the two manoeuvres."""
    return max(
        tables.over_ckf(results, name, number, state, case) for number in range(len(MANOEUVRES))
    )


def _span(results: ScoresByFilter, name: str, case: str) -> str:
    worst = [_worst(results, name, case, state) for state in tables.JUDGED]
    return " / ".join(f"{value:.2f}" for value in worst)


def better_model(
    results: ScoresByFilter, improved: ScoresByFilter, identified: Identified
) -> Section:
    """The side slip's error is the model's."""
    at, i = case_index("true R"), state_index("side slip")
    rows = [
        [
            f"{name}, {model}",
            *(tables.with_interval(r[name].rmse[number, at, :, i]) for number in range(2)),
        ]
        for name in ("CKF", "ADLUKF")
        for model, r in (("linear tyres of the data sheet", results), ("tyres fitted", improved))
    ]
    parts = [
        f"Tyres that saturate, {_kilonewtons(identified)}, friction {identified.car.friction:.2f}, "
        f"identified from the {IDENTIFIED_FROM} drive, not from the manoeuvres judged here. RMSE "
        "of the side slip in °:",
        markdown_table(["filter and model", *MANOEUVRES], rows),
        "No adaptation of noise removes an error of the model.",
    ]
    gain = [
        improved["CKF"].rmse[n, at, :, i].mean() / results["CKF"].rmse[n, at, :, i].mean()
        for n in range(2)
    ]
    checks = [
        at_most(f"side slip of the CKF with fitted tyres over that without, {title}", value, 0.8)
        for title, value in zip(MANOEUVRES, gain, strict=True)
    ]
    title = "The side slip needs a better model, not a better filter"
    return Section(100, title, "\n\n".join(parts), checks)


def logged_drives(
    logged: Logged,
    of_models: Mapping[str, Mapping[str, np.ndarray]],
    traces: Mapping[str, StateTrace],
) -> Section:
    """Figure 9, and what identification found."""
    head = ["RMSE of the side slip [°], CKF", *MANOEUVRES]
    models = list(next(iter(of_models.values())))
    rows = [
        [
            model,
            *(
                f"{side_slip_rmse_deg(logged.drives[name].drive, of_models[name][model]):.3f}"
                for name in DRIVEN
            ),
        ]
        for model in models
    ]
    filters = [
        [
            name,
            *(
                f"{side_slip_rmse_deg(logged.drives[d].drive, traces[t].estimates[name]):.3f}"
                for d, t in zip(DRIVEN, MANOEUVRES, strict=True)
            ),
        ]
        for name in COMPARED
    ]
    linear, tanh = logged.linear, logged.tanh
    parts = [
        "The paper's Volkswagen Santana and its data are not public. In their place stands a "
        "simulated Ford Escort whose drives were written to CSV with the noise of their sensors "
        "(the folders `drive-*` beside this report), read again, and identified from the "
        f"{IDENTIFIED_FROM} drive as a user's log would be: linear tyres {_kilonewtons(linear)}, "
        f"saturating tyres {_kilonewtons(tanh)} with friction {tanh.car.friction:.2f} ± "
        f"{tanh.friction_std:.2f}. So this shows the way, and proves nothing about real cars.",
        "![figure-9.png](figure-9.png)",
        markdown_table(head, rows),
        "With the identified linear tyres:",
        markdown_table(["RMSE of the side slip [°]", *MANOEUVRES], filters),
    ]
    return Section(120, "Figure 9: logged drives", "\n\n".join(parts))


def _kilonewtons(found: Identified) -> str:
    front, rear = found.car.front_stiffness_n_rad / 1e3, found.car.rear_stiffness_n_rad / 1e3
    return f"{front:.0f} and {rear:.0f} kN/rad"
