"""The sections of the ADLUKF report; every sentence that judges is made from numbers."""

from collections.abc import Mapping

import numpy as np

from experiments import reproduce_adlukf_tables as tables
from experiments.reproduce_adlukf_cost import Cost
from experiments.reproduce_adlukf_drives import DRIVEN
from experiments.reproduce_adlukf_study import (
    ACCELERATION,
    CASES,
    CHANNELS,
    PROCESS_VARIANCES,
    STEERING,
)
from experiments.reproduce_adlukf_tables import COMPARED, Results, case_index, ratio, state_index
from experiments.reproduce_report import (
    Check,
    Claim,
    Section,
    Verdict,
    above,
    at_most,
    markdown_table,
    near,
)
from nodes.messages import Array
from plants.vehicle_drive import Drive

MANOEUVRES = tuple(name.replace("-", " ") for name in DRIVEN)
SHOWN = ("CKF", "FAUKF", "ADLUKF", "AUKF", "MCUKF", "ADLUKF printed", "DLUKF")


def set_up(drives: tuple[Drive, ...], seeds: int) -> Section:
    """What was driven, measured and filtered."""
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
        ["manoeuvre", "length", "v_x [m/s]", "a_y at most [m/s²]", "β at most [°]", "ω [°/s]"],
        rows,
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


def table_2(results: Results, drives: tuple[Drive, ...]) -> Section:
    """Table 2, and who is better."""
    text = (
        "R0 is the true covariance of the sensors; mean over the seeds with its interval of 95 %."
        f"\n\n{tables.table_2(results, MANOEUVRES)}"
    )
    claims = [_best_claim(results, *claim) for claim in _BEST_CLAIMS]
    claims.append(_impossible_claim())
    claims.append(_yaw_claim(results, drives))
    return Section(30, "Table 2: errors when R is known", text, [], claims, shown=True)


def errors(results: Results) -> Section:
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


_BEST_CLAIMS = (
    ("4.1.1, 4.1.2, Table 2", "the ADLUKF estimates the yaw rate best", "rmse", "yaw rate"),
    ("4.1.1, 4.1.2, Table 2", "the ADLUKF estimates side slip and v_y best", "rmse", "side slip"),
    ("4.1.1, 4.1.2, Table 2", "the ADLUKF's mean absolute error of v_x is least", "mae", "v_x"),
)


def _best_claim(results: Results, where: str, says: str, measure: str, state: str) -> Claim:
    at, i = case_index("true R"), state_index(state)
    best, found = True, []
    for number, title in enumerate(MANOEUVRES):
        mean = {n: getattr(results[n], measure)[number, at, :, i].mean() for n in COMPARED}
        best &= mean["ADLUKF"] < min(mean["CKF"], mean["FAUKF"])
        found.append(f"{title}: " + ", ".join(f"{n} {value:.3g}" for n, value in mean.items()))
    verdict: Verdict = "reproduced" if best else "not reproducible as printed"
    unit = tables.UNITS[i]
    return Claim(where, says, verdict, f"{measure.upper()} [{unit}], R known; " + "; ".join(found))


def _impossible_claim() -> Claim:
    mae, rmse = tables.TABLE_2["MAE", "v_x", "m/s"][2], tables.TABLE_2["RMSE", "v_x", "m/s"][2]
    return Claim(
        "Table 2",
        f"the ADLUKF's v_x has an RMSE of {rmse} with an MAE of {mae}",
        "wrong",
        "no set of errors has an RMSE below its MAE",
    )


def _yaw_claim(results: Results, drives: tuple[Drive, ...]) -> Claim:
    printed = tables.TABLE_2["MAE", "yaw rate", "rad/s"][0]
    at, i = case_index("true R"), state_index("yaw rate")
    ours = [results["CKF"].mae[number, at, :, i].mean() for number in range(len(MANOEUVRES))]
    signal = [np.degrees(np.abs(drive.yaw_rate_rad_s)).mean() for drive in drives]
    return Claim(
        "Table 2",
        f"the CKF errs by {printed} rad/s in the yaw rate on average ({np.degrees(printed):.0f} "
        "deg/s)",
        "not reproducible as printed",
        f"{ours[0]:.3f} and {ours[1]:.3f} deg/s; to guess 0 all the way would err by "
        f"{signal[0]:.1f} and {signal[1]:.1f} deg/s",
    )


def sensitivity(results: Results) -> Section:
    """Table 3: how much a wrong start of R costs."""
    checks: list[Check] = []
    for number, title in enumerate(MANOEUVRES):
        for state in ("v_x", "yaw rate"):
            ours, reference = (ratio(results, n, number, state) for n in ("ADLUKF", "CKF"))
            words = f"RMSE(2 I) / RMSE(0.01 I) of {state}, {title}"
            checks.append(near(f"ADLUKF: {words}", ours, 1.0, 0.2))
            checks.append(above(f"CKF: {words}", reference, 1.3))
    insensitive = all(check.ok for check in checks)
    ckf = [ratio(results, "CKF", n, "side slip") for n in range(len(MANOEUVRES))]
    claims = [
        Claim(
            "Table 3",
            "the CKF is sensitive to the starting R, the ADLUKF is not",
            "reproduced" if insensitive else "not reproducible as printed",
            "in v_x and yaw rate, by the ratios of the checks",
        ),
        Claim(
            "Table 3",
            "with R0 = 2 I instead of 0.01 I the CKF's side slip is 41 times worse",
            "reproduced" if min(ckf) > 10 else "not reproducible as printed",
            f"ratios {ckf[0]:.2f} and {ckf[1]:.2f}: with a huge R the CKF runs open loop, and the "
            "side slip of the model alone is no worse",
        ),
    ]
    text = tables.table_3(results, MANOEUVRES)
    return Section(40, "Table 3: sensitivity to the starting R", text, checks, claims, shown=True)


def other_noise(results: Results) -> Section:
    """All cases, all filters."""
    parts = [
        "\n".join(f"- **{case.name}**: {case.what}." for case in CASES.values()),
        "RMSE in m/s, ° and °/s, mean over the seeds; the least within half a per cent in bold.",
    ]
    for number, title in enumerate(MANOEUVRES):
        parts += [f"### {title}", tables.cases_table(results, number, list(results))]
    return Section(50, "Every filter in every case", "\n\n".join(parts))


def spread(results: Results, signal_sd: Mapping[str, Array]) -> Section:
    """Table 4."""
    rmse, sd = tables.TABLE_2["RMSE", "v_x", "m/s"][0], tables.TABLE_4["v_x", "m/s"][0]
    bias, mae = float(np.sqrt(rmse**2 - sd**2)), tables.TABLE_2["MAE", "v_x", "m/s"][0]
    yaw = tables.TABLE_4["yaw rate", "rad/s"]
    claims = [
        Claim(
            "Table 4",
            f"the SD of the CKF's v_x is {sd}",
            "wrong",
            f"with the RMSE of {rmse} of Table 2 the mean error would be {bias:.3f}, more than the "
            f"mean absolute error of {mae}",
        ),
        Claim(
            "Table 4",
            f"the SD of the yaw rate is {yaw[0]} to {yaw[2]} rad/s",
            "not reproducible as printed",
            f"that is {np.degrees(yaw[0]):.0f} deg/s; in deg/s it would be the SD of the signal, "
            "which hardly depends on the filter and says nothing of errors",
        ),
    ]
    text = tables.table_4(results, dict(signal_sd), MANOEUVRES)
    return Section(60, "Table 4: standard deviations", text, [], claims, shown=True)


def consistency(nees: Mapping[str, Array]) -> Section:
    """Who knows how wrong it is."""
    rows = [[name, tables.with_interval(values)] for name, values in nees.items()]
    text = f"""\
Data that obey the filters' model exactly, process noise and start included. A consistent filter's
average NEES is 3, the number of states; above, it is overconfident.

{markdown_table(["filter", "average NEES"], rows)}"""
    checks = [
        near("average NEES of the UKF on matched data", float(nees["UKF"].mean()), 3.0, 0.3),
        near(
            "average NEES of the dual layer that counts a reading once",
            float(nees["DLUKF consistent"].mean()),
            3.0,
            0.3,
        ),
        above("average NEES of the dual layer of the paper", float(nees["DLUKF"].mean()), 3.3),
    ]
    return Section(70, "Consistency: the dual layer counts every reading twice", text, checks)


def cost(of_filters: Mapping[str, Cost]) -> Section:
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
    more = of_filters["ADLUKF"].evaluations / reference.evaluations
    printed = tables.TABLE_1_S["ADLUKF"] / tables.TABLE_1_S["CKF"] - 1
    claim = Claim(
        "Table 1",
        f"the ADLUKF costs {100 * printed:.0f} % more time than the CKF",
        "not reproducible as printed",
        f"{more:.1f} times the model evaluations, "
        f"{of_filters['ADLUKF'].seconds / reference.seconds:.1f} times the time here; the paper's "
        "times are those of a co-simulation, of which a filter is the least part",
    )
    text = "Times belong to the machine that wrote this; evaluations do not.\n\n"
    return Section(80, "Table 1: cost", text + markdown_table(head, rows), [], [claim], shown=True)


def ablations(
    results: Results, ukf_minus_ckf: Mapping[str, float], failed_lanes: Mapping[str, int]
) -> Section:
    """What the inner layer brings, and what the adaptation; the two filters' difference by case."""
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
    failed = sum(failed_lanes.values())
    printed = min(
        tables.over_ckf(results, "ADLUKF printed", number, state)
        for number in range(len(MANOEUVRES))
        for state in tables.JUDGED
    )
    claims = [
        Claim(
            "4.2",
            "the CKF is distorted because its covariance is not positive definite",
            "not reproducible as printed" if not failed_lanes["CKF"] else "reproduced",
            f"{failed_lanes['CKF']} of the CKF's runs lost it ({failed} of all filters'); its "
            "weights are all positive, so it cannot",
        ),
        Claim(
            "3.3",
            "Sage-Husa adaptation of Q and R with |diag| reduces the influence of the noise",
            "reproduced" if printed < 1 else "not reproducible as printed",
            f"at the true R, {printed:.2f} times the CKF's RMSE in the state where it is best: Q "
            "and R cannot be told apart from one innovation; R alone in residual form can",
        ),
    ]
    checks = [at_most("largest |UKF - CKF| with the true R", ukf_minus_ckf["true R"], 1e-7)]
    return Section(90, "Ablations: what brings what", text, checks, claims)


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


def _ablation_at(results: Results, case: str) -> str:
    at, true = case_index(case), case_index("true R")
    states = [state_index(state) for state in tables.JUDGED]
    change = {}
    for name in ("CKF", *_ABLATIONS):
        rmse = np.sqrt((results[name].rmse ** 2).mean(axis=2))
        change[name] = (rmse[:, at] / rmse[:, true])[:, states]
    return tables.per_state(change, "RMSE over that at the true R", MANOEUVRES)


def figures(files: list[str]) -> Section:
    """Figures 4 and 5."""
    lines = [f"![{name}]({name})" for name in files]
    text = "One seed; the two lowest rows are means over all seeds.\n\n" + "\n\n".join(lines)
    return Section(110, "Figures 4 and 5", text)
