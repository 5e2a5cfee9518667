"""The sections of the ADLUKF report; every sentence that judges is made from numbers."""

from collections.abc import Mapping

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.papers.adlukf import tables
from concord.papers.adlukf.claims import MANOEUVRES
from concord.papers.adlukf.cost import FilterCost
from concord.papers.adlukf.study import ACCELERATION, CASES, CHANNELS, PROCESS_VARIANCES, STEERING
from concord.papers.adlukf.tables import ScoresByFilter, case_index, ratio, state_index
from concord.papers.kit.checks import Check, above, agrees, at_most, near
from concord.papers.kit.report import Section, markdown_table
from concord.results.figures.intervals import positive_mean_t

SHOWN = ("CKF", "FAUKF", "ADLUKF", "AUKF", "MCUKF", "ADLUKF printed", "DLUKF")


def set_up(drives: tuple[Drive, ...], seeds: int) -> Section:
    """Return the section on the drives, the measurements and the filters."""
    rows = []
    for name, drive in zip(MANOEUVRES, drives, strict=True):
        side_slip, yaw_rate = np.degrees(drive.side_slip_rad), np.degrees(drive.yaw_rate_rad_s)
        rows.append(
            [
                name,
                f"{drive.time_s[-1]:g} s",
                f"{drive.speed_m_s[0]:.1f} to {drive.speed_m_s[-1]:.1f}",
                f"{np.abs(drive.lateral_acceleration_m_s2).max():.2f}",
                f"{np.abs(side_slip).max():.2f} (SD {side_slip.std():.2f})",
                f"SD {yaw_rate.std():.1f}",
            ]
        )
    driven = markdown_table(
        ["manoeuvre", "length", "v_x [m/s]", "a_y at most [m/s²]", "β at most [°]", "ω [°/s]"], rows
    )
    noise = "; ".join(f"{name} {error.std:g}" for name, error in CHANNELS.items())
    parts = [
        "The truth is a BMW 320i with 29 states (CommonRoad multi-body model), integrated by "
        "Runge-Kutta in steps of 1 ms and sampled every 10 ms; it shares no equation with the "
        "filters. They believe in a single-track model with linear tyres of the data sheet.",
        driven,
        f"Noise (standard deviations, SI): {noise}; inputs: steering {STEERING.std:g}, "
        f"longitudinal acceleration {ACCELERATION.std:g} with a bias of {ACCELERATION.bias:g}. "
        f"Q = diag{PROCESS_VARIANCES} per step for all filters. {seeds} seeds of sensor noise; "
        "intervals are of 95 % (Student's t) and cover that noise alone: car, manoeuvres and Q are "
        "one choice each. With fewer than 20 seeds a check may fail by chance.",
        tables.filters_table(),
    ]
    return Section(20, "What was done", "\n\n".join(parts))


def table_2(results: ScoresByFilter) -> Section:
    """Return the section on table 2 and on the better filter."""
    text = (
        "R0 is the true covariance of the sensors; mean over the seeds with its interval of 95 %."
        f"\n\n{tables.table_2(results, MANOEUVRES)}"
    )
    return Section(30, "Table 2: errors when R is known", text, shown=True)


def errors(results: ScoresByFilter) -> Section:
    """Every error of the filters that matter, and by how much they differ from the CKF's."""
    parts = ["R0 is the true covariance of the sensors."]
    for number, title in enumerate(MANOEUVRES):
        parts += [
            f"### {title}",
            tables.errors_table(results, number, "true R", SHOWN),
            tables.against_ckf_table(results, number, SHOWN[1:]),
        ]
    checks = [
        above(
            f"printed ADLUKF over CKF at the true R, RMSE of {state}, {title}",
            tables.over_ckf(results, "ADLUKF printed", number, state),
            1.0,
        )
        for number, title in enumerate(MANOEUVRES)
        for state in tables.JUDGED
    ]
    return Section(35, "MAE, RMSE and SD when R is known", "\n\n".join(parts), checks)


def sensitivity(results: ScoresByFilter) -> Section:
    """Table 3: how much a wrong start of R costs."""
    checks: list[Check] = []
    for number, title in enumerate(MANOEUVRES):
        for state in ("v_x", "yaw rate"):
            ours, reference = (ratio(results, n, number, state) for n in ("ADLUKF", "CKF"))
            words = f"RMSE(2 I) / RMSE(0.01 I) of {state}, {title}"
            checks.append(near(f"ADLUKF: {words}", ours, 1.0, 0.2))
            checks.append(above(f"CKF: {words}", reference, 1.3))
    text = tables.table_3(results, MANOEUVRES)
    return Section(40, "Table 3: sensitivity to the starting R", text, checks, shown=True)


def other_noise(results: ScoresByFilter) -> Section:
    """All cases, all filters."""
    parts = [
        "\n".join(f"- **{case.name}**: {case.what}." for case in CASES.values()),
        "RMSE in m/s, ° and °/s, mean over the seeds; the least within half a per cent in bold.",
    ]
    for number, title in enumerate(MANOEUVRES):
        parts += [f"### {title}", tables.cases_table(results, number, list(results))]
    return Section(50, "Every filter in every case", "\n\n".join(parts))


def spread(results: ScoresByFilter, signal_sd: Mapping[str, np.ndarray]) -> Section:
    """Table 4."""
    text = tables.table_4(results, dict(signal_sd), MANOEUVRES)
    return Section(60, "Table 4: standard deviations", text, shown=True)


def consistency(nees: Mapping[str, np.ndarray]) -> Section:
    """Return the section on consistency: the average NEES of each filter."""
    rows = [[name, tables.with_interval(values)] for name, values in nees.items()]
    seeds = len(nees["UKF"])
    text = f"""\
Data that obey the filters' model exactly, process noise and start included. A consistent filter's
average NEES is 3, the number of states; above, it is overconfident.

{markdown_table(["filter", "average NEES"], rows)}"""
    checks = [
        *(
            agrees(
                f"average NEES of {words} on matched data", positive_mean_t(nees[name]), seeds, 3.0
            )
            for name, words in (
                ("UKF", "the UKF"),
                ("DLUKF consistent", "the dual layer that counts a reading once"),
            )
        ),
        above("average NEES of the dual layer of the paper", float(nees["DLUKF"].mean()), 3.3),
    ]
    return Section(70, "Consistency: the dual layer counts every reading twice", text, checks)


def cost(of_filters: Mapping[str, FilterCost]) -> Section:
    """Table 1."""
    reference = of_filters["CKF"]
    rows = [
        [
            name,
            f"{tables.TABLE_1_S[name]} s" if name in tables.TABLE_1_S else "",
            f"{c.evaluations:.0f}",
            f"{c.seconds / reference.seconds:.1f}",
        ]
        for name, c in of_filters.items()
    ]
    head = ["filter", "paper: total time", "model evaluations a step", "time over the CKF's, here"]
    text = "Times belong to the machine that wrote this; evaluations do not.\n\n"
    return Section(80, "Table 1: cost", text + markdown_table(head, rows), shown=True)


def ablations(results: ScoresByFilter, ukf_minus_ckf: Mapping[str, float]) -> Section:
    """Return the section on ablations: inner layer, adaptation, and UKF against CKF by case."""
    over = {
        f"{name}: {words}": np.array(
            [
                [tables.over_ckf(results, name, number, state) for state in tables.JUDGED]
                for number in range(len(MANOEUVRES))
            ]
        )
        for name, words in _ABLATIONS.items()
    }
    differences = ", ".join(f"{case} {value:.0e}" for case, value in ukf_minus_ckf.items())
    text = f"""\
{tables.per_state(over, "RMSE over the CKF's at the true R", MANOEUVRES)}

The same with R0 = 2 I, where adaptation matters:

{_ablation_at(results, "2 I")}

The largest difference of UKF and CKF in any state (rad/s, rad, m/s), step, seed and manoeuvre, by
case: {differences}.
Their points are exact to the same degree; the models are so mildly curved that the rest shows only
where the belief is wide: while R is believed huge, or the speed is hardly observed."""
    checks = [at_most("largest |UKF - CKF| with the true R", ukf_minus_ckf["true R"], 1e-7)]
    return Section(90, "Ablations: what brings what", text, checks)


_ABLATIONS = {
    "AUKF": "adaptation, no inner layer",
    "DLUKF": "inner layer, no adaptation",
    "DLUKF consistent": "inner layer that counts a reading once",
    "ADLUKF": "both",
    "ADLUKF printed": "both, Q adapted too",
    "ADLUKF printed, q r": "both, Q and the means adapted too",
    "AUKF limited": "adaptation that trusts no reading beyond 3 sigma",
    "MCUKF": "maximum correntropy instead",
}


def _ablation_at(results: ScoresByFilter, case: str) -> str:
    at, true = case_index(case), case_index("true R")
    states = [state_index(state) for state in tables.JUDGED]
    change = {}
    for name in ("CKF", *_ABLATIONS):
        rmse = np.sqrt((results[name].rmse ** 2).mean(axis=2))
        change[name] = (rmse[:, at] / rmse[:, true])[:, states]
    return tables.per_state(change, "RMSE over that at the true R", MANOEUVRES)
