"""The sections of the ADLUKF report; every sentence that judges is made from numbers.

Tables 1 to 4 of the paper stand beside what was measured, with intervals over the seeds.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.features.vehicle.plant.tyre_identification import Identified
from concord.papers.adlukf.drives import (
    DRIVEN,
    IDENTIFIED_FROM,
    Elsewhere,
    Logged,
    side_slip_rmse_deg,
)
from concord.papers.adlukf.figures import StateTrace
from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.study import (
    ACCELERATION,
    CASES,
    CHANNELS,
    JUDGED,
    MANOEUVRES,
    PROCESS_VARIANCES,
    STATES,
    STEERING,
    UNITS,
    ErrorScores,
    FilterCost,
    ScoresByFilter,
    each_seed,
    over_ckf,
    ratio,
)
from concord.papers.kit.judging import Check, above, agrees, at_most, below, near
from concord.papers.kit.report import Section, markdown_table
from concord.results.figures.intervals import Interval, mean_t, positive_mean_t, ratio_t

SHOWN = ("CKF", "FAUKF", "ADLUKF", "AUKF", "MCUKF", "ADLUKF printed", "DLUKF")
COMPARED = ("CKF", "FAUKF", "ADLUKF")
"""The columns of the paper's tables."""

TABLE_1_S = {"CKF": 6.316, "FAUKF": 6.346, "ADLUKF": 6.381}
TABLE_2 = {
    ("MAE", "v_x", "m/s"): (0.311, 0.158, 0.139),
    ("MAE", "v_y", "m/s"): (0.187, 0.0563, 0.0452),
    ("MAE", "yaw rate", "rad/s"): (0.312, 0.0198, 0.0163),
    ("RMSE", "v_x", "m/s"): (0.338, 0.243, 0.126),
    ("RMSE", "v_y", "m/s"): (0.249, 0.0621, 0.0502),
    ("RMSE", "yaw rate", "rad/s"): (0.412, 0.0301, 0.0206),
}
TABLE_3 = {"ADLUKF": (0.001, 0.003), "CKF": (0.002, 0.082)}
"""RMSE of the side slip, in no stated unit, with R0 = 0.01 I and R0 = 2 I."""
TABLE_4 = {
    ("v_x", "m/s"): (0.0704, 0.0524, 0.0372),
    ("side slip", "deg"): (0.2752, 0.2486, 0.2383),
    ("yaw rate", "rad/s"): (3.3763, 3.3668, 3.3534),
}


def with_interval(values: np.ndarray) -> str:
    """Mean ± half width of values of 0 or more, both to the first digit of the half width, or two
    if it is a 1. Both bounds in place of the half width where one is far from the other."""
    interval = positive_mean_t(values)
    mean, low, high = interval
    half = (high - low) / 2
    if not (np.isfinite(half) and half > 0):
        return f"{mean:.3g}"
    if "to" in (bounds := interval.spread()):
        return f"{mean:.3g} {bounds}"
    magnitude = int(np.floor(np.log10(half)))
    places = max(0, -magnitude + (half < 2 * 10.0**magnitude))
    return f"{mean:.{places}f} ± {half:.{places}f}"


def slashed(values: Iterable[float]) -> str:
    """Factors to two places."""
    return " / ".join(f"{value:.2f}" for value in values)


def per_state(rows: Mapping[str, np.ndarray], what: str) -> str:
    """A row for each of `rows`, factors (manoeuvres, 3) of the `JUDGED` states, to two places."""
    head = [f"{what} ({' / '.join(MANOEUVRES)})", *JUDGED]
    return markdown_table(head, [[name, *map(slashed, of.T)] for name, of in rows.items()])


def unit_of(state: str) -> str:
    """The unit of a state's errors."""
    return UNITS[STATES.index(state)]


# --- what was done, and the errors ---------------------------------------------------------------


def set_up(drives: tuple[Drive, ...], seeds: int) -> Section:
    """Return the section on the drives, the measurements and the filters."""
    rows = []
    for name, drive in zip(MANOEUVRES, drives, strict=True):
        side_slip, yaw_rate = np.degrees(drive.side_slip_rad), np.degrees(drive.yaw_rate_rad_s)
        rows.append([
            name,
            f"{drive.time_s[-1]:g} s",
            f"{drive.speed_m_s[0]:.1f} to {drive.speed_m_s[-1]:.1f}",
            f"{np.abs(drive.lateral_acceleration_m_s2).max():.2f}",
            f"{np.abs(side_slip).max():.2f} (SD {side_slip.std():.2f})",
            f"SD {yaw_rate.std():.1f}",
        ])  # fmt: skip
    head = ["manoeuvre", "length", "v_x [m/s]", "a_y at most [m/s²]", "β at most [°]", "ω [°/s]"]
    noise = "; ".join(f"{name} {error.std:g}" for name, error in CHANNELS.items())
    parts = [
        "The truth is a BMW 320i with 29 states (CommonRoad multi-body model), integrated by "
        "Runge-Kutta in steps of 1 ms and sampled every 10 ms; it shares no equation with the "
        "filters. They believe in a single-track model with linear tyres of the data sheet.",
        markdown_table(head, rows),
        f"Noise (standard deviations, SI): {noise}; inputs: steering {STEERING.std:g}, "
        f"longitudinal acceleration {ACCELERATION.std:g} with a bias of {ACCELERATION.bias:g}. "
        f"Q = diag{PROCESS_VARIANCES} per step for all filters. {seeds} seeds of sensor noise; "
        "intervals are of 95 % (Student's t) and cover that noise alone: car, manoeuvres and Q are "
        "one choice each. With fewer than 20 seeds a check may fail by chance.",
        markdown_table(
            ["filter", "what it is"], [[name, one.what] for name, one in CONTESTANTS.items()]
        ),
    ]
    return Section(20, "What was done", "\n\n".join(parts))


def table_2(results: ScoresByFilter) -> Section:
    """The paper's MAE and RMSE above ours; yaw rates in the paper's unit."""
    rows = []
    for (measure, state, unit), printed in TABLE_2.items():
        scale = np.pi / 180 if unit == "rad/s" else 1.0
        what = f"{measure} {state} [{unit}]"
        rows.append([what, "paper", *(f"{value:g}" for value in printed)])
        values = [each_seed(results[name], measure.lower(), state) for name in COMPARED]
        for m, title in enumerate(MANOEUVRES):
            rows.append([what, title, *(with_interval(scale * one[m]) for one in values)])
    text = (
        "R0 is the true covariance of the sensors; mean over the seeds with its interval of 95 %."
        f"\n\n{markdown_table(['', '', *COMPARED], rows)}"
    )
    return Section(30, "Table 2: errors when R is known", text, shown=True)


def errors(results: ScoresByFilter) -> Section:
    """Every error of the filters that matter, and by how much they differ from the CKF's."""
    head = ["filter", *(f"{name} [{unit}]" for name, unit in zip(STATES, UNITS, strict=True))]
    parts = ["R0 is the true covariance of the sensors."]
    for m, title in enumerate(MANOEUVRES):
        rows, against = [], []
        for measure, name in product(ErrorScores._fields, SHOWN):
            cells = [with_interval(each_seed(results[name], measure, s)[m]) for s in STATES]
            rows.append([f"{measure.upper()} {name}", *cells])
        for name in SHOWN[1:]:
            ours, reference = (
                np.array([each_seed(results[n], "rmse", state)[m] for state in STATES])
                for n in (name, "CKF")
            )
            against.append([name, *map(_signed, 100 * (ours / reference - 1))])
        table = markdown_table(["RMSE against the CKF, %", *STATES], against)
        parts += [f"### {title}", markdown_table(head, rows), table]
    checks = [
        above(
            f"printed ADLUKF over CKF at the true R, RMSE of {state}, {title}",
            over_ckf(results, "ADLUKF printed", m, state),
            1.0,
        )
        for (m, title), state in product(enumerate(MANOEUVRES), JUDGED)
    ]
    return Section(35, "MAE, RMSE and SD when R is known", "\n\n".join(parts), checks)


def _signed(values: np.ndarray) -> str:
    mean, low, high = mean_t(values)
    half = (high - low) / 2
    return f"{mean:+.1f} ± {half:.1f}" if np.isfinite(half) else f"{mean:+.1f}"


def sensitivity(results: ScoresByFilter) -> Section:
    """Table 3: RMSE with R0 = 0.01 I and 2 I and their ratio, the paper's side slip first."""
    rows = [
        [f"paper, {name}, side slip", f"{low:g}", f"{high:g}", f"{high / low:.1f}"]
        for name, (low, high) in TABLE_3.items()
    ]
    filters = ("CKF", "FAUKF", "ADLUKF", "AUKF")
    states = ("side slip", "yaw rate", "v_x")
    for (m, title), state, name in product(enumerate(MANOEUVRES), states, filters):
        ends = [each_seed(results[name], "rmse", state, case)[m] for case in ("0.01 I", "2 I")]
        what = f"{title}, {name}, {state} [{unit_of(state)}]"
        rows.append(
            [what, *map(with_interval, ends), f"{ratio(results, name, m, state).value:.2f}"]
        )
    checks: list[Check] = []
    for (m, title), state in product(enumerate(MANOEUVRES), ("v_x", "yaw rate")):
        words = f"RMSE(2 I) / RMSE(0.01 I) of {state}, {title}"
        checks.append(near(f"ADLUKF: {words}", ratio(results, "ADLUKF", m, state), 1.0, 0.2))
        checks.append(above(f"CKF: {words}", ratio(results, "CKF", m, state), 1.3))
    text = markdown_table(["", "R0 = 0.01 I", "R0 = 2 I", "ratio"], rows)
    return Section(40, "Table 3: sensitivity to the starting R", text, checks, shown=True)


def other_noise(results: ScoresByFilter) -> Section:
    """All cases, all filters: RMSE of v_x, side slip and yaw rate, the least of each in bold."""
    parts = [
        "\n".join(f"- **{case.name}**: {case.what}." for case in CASES.values()),
        "RMSE in m/s, ° and °/s, mean over the seeds; the least within half a per cent in bold.",
    ]
    places = [STATES.index(state) for state in JUDGED]
    for m, title in enumerate(MANOEUVRES):
        cells = {name: one.rmse[m].mean(axis=1)[:, places] for name, one in results.items()}
        least = np.min(list(cells.values()), axis=0)
        rows = []
        for name, values in cells.items():
            bold = np.where(values <= 1.005 * least, "**", "")
            of_cases = zip(values, bold, strict=True)
            rows.append([name, *(" ".join(
                f"{mark}{value:.3f}{mark}" for value, mark in zip(*pair, strict=True)
            ) for pair in of_cases)])  # fmt: skip
        table = markdown_table(["RMSE of " + ", ".join(JUDGED), *CASES], rows)
        parts += [f"### {title}", table]
    return Section(50, "Every filter in every case", "\n\n".join(parts))


def spread(results: ScoresByFilter, signal_sd: Mapping[str, np.ndarray]) -> Section:
    """Table 4: the paper's SD beside that of the errors and that of the estimated signals.

    `signal_sd` by filter: (manoeuvres, 4).
    """
    rows = [
        [f"paper, {state} [{unit}]", *(f"{value:g}" for value in printed)]
        for (state, unit), printed in TABLE_4.items()
    ]
    for (m, title), state in product(enumerate(MANOEUVRES), JUDGED):
        what = f"{title}, {state} [{unit_of(state)}]"
        of_errors = [with_interval(each_seed(results[n], "sd", state)[m]) for n in COMPARED]
        signals = [f"{signal_sd[n][m, STATES.index(state)]:.4g}" for n in COMPARED]
        rows += [[f"{what}, of the error", *of_errors], [f"{what}, of the estimate", *signals]]
    text = markdown_table(["", *COMPARED], rows)
    return Section(60, "Table 4: standard deviations", text, shown=True)


# --- consistency, cost, ablations ----------------------------------------------------------------


def consistency(nees: Mapping[str, np.ndarray]) -> Section:
    """Return the section on consistency: the average NEES of each filter."""
    rows = [[name, with_interval(values)] for name, values in nees.items()]
    text = f"""\
Data that obey the filters' model exactly, process noise and start included. A consistent filter's
average NEES is 3, the number of states; above, it is overconfident.

{markdown_table(["filter", "average NEES"], rows)}"""
    named = {
        "UKF": "the UKF",
        "DLUKF consistent": "the dual layer that counts a reading once",
    }
    checks = [
        agrees(f"average NEES of {words} on matched data", positive_mean_t(of), len(of), 3.0)
        for words, of in ((words, nees[name]) for name, words in named.items())
    ]
    own = positive_mean_t(nees["DLUKF"])
    checks.append(above("average NEES of the dual layer of the paper", own, 3.3))
    return Section(70, "Consistency: the dual layer counts every reading twice", text, checks)


def cost(of_filters: Mapping[str, FilterCost]) -> Section:
    """Table 1."""
    reference = of_filters["CKF"].seconds
    rows = [
        [
            name,
            f"{TABLE_1_S[name]} s" if name in TABLE_1_S else "",
            f"{c.evaluations:.0f}",
            f"{c.seconds / reference:.1f}",
        ]
        for name, c in of_filters.items()
    ]
    head = ["filter", "paper: total time", "model evaluations a step", "time over the CKF's, here"]
    text = "Times belong to the machine that wrote this; evaluations do not.\n\n"
    return Section(80, "Table 1: cost", text + markdown_table(head, rows), shown=True)


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


def ablations(results: ScoresByFilter, ukf_minus_ckf: Mapping[str, float]) -> Section:
    """Return the section on ablations: inner layer, adaptation, and UKF against CKF by case."""

    def table(names: Mapping[str, str], what: str, factor: Callable[[str, int, str], float]) -> str:
        rows = {
            title: np.array([[factor(n, m, s) for s in JUDGED] for m in range(len(MANOEUVRES))])
            for n, title in names.items()
        }
        return per_state(rows, what)

    def change(name: str, m: int, state: str) -> float:
        of_cases = (each_seed(results[name], "rmse", state, case)[m] for case in ("2 I", "true R"))
        high, low = (np.sqrt((one**2).mean()) for one in of_cases)
        return high / low

    over = table(
        {name: f"{name}: {words}" for name, words in _ABLATIONS.items()},
        "RMSE over the CKF's at the true R",
        lambda name, m, state: over_ckf(results, name, m, state).value,
    )
    changed = table(
        {name: name for name in ("CKF", *_ABLATIONS)}, "RMSE over that at the true R", change
    )
    differences = ", ".join(f"{case} {value:.0e}" for case, value in ukf_minus_ckf.items())
    text = f"""\
{over}

The same with R0 = 2 I, where adaptation matters:

{changed}

The largest difference of UKF and CKF in any state (rad/s, rad, m/s), step, seed and manoeuvre, by
case: {differences}.
Their points are exact to the same degree; the models are so mildly curved that the rest shows only
where the belief is wide: while R is believed huge, or the speed is hardly observed."""
    checks = [at_most("largest |UKF - CKF| with the true R", ukf_minus_ckf["true R"], 1e-7)]
    return Section(90, "Ablations: what brings what", text, checks)


# --- a better model, other cars, logged drives ---------------------------------------------------


def better_model(
    results: ScoresByFilter, improved: ScoresByFilter, identified: Identified
) -> Section:
    """The side slip's error is the model's."""
    models = {"linear tyres of the data sheet": results, "tyres fitted": improved}
    rows = [
        [f"{name}, {model}", *map(with_interval, each_seed(r[name], "rmse", "side slip"))]
        for name in ("CKF", "ADLUKF")
        for model, r in models.items()
    ]
    parts = [
        f"Tyres that saturate, {_kilonewtons(identified)}, friction {identified.car.friction:.2f}, "
        f"identified from the {IDENTIFIED_FROM} drive, not from the manoeuvres judged here. RMSE "
        "of the side slip in °:",
        markdown_table(["filter and model", *MANOEUVRES], rows),
        "No adaptation of noise removes an error of the model.",
    ]
    after, before = (each_seed(r["CKF"], "rmse", "side slip") for r in (improved, results))
    checks = [
        at_most(
            f"side slip of the CKF with fitted tyres over that without, {title}",
            ratio_t(after[m] ** 2, before[m] ** 2),
            0.8,
        )
        for m, title in enumerate(MANOEUVRES)
    ]
    title = "The side slip needs a better model, not a better filter"
    return Section(100, title, "\n\n".join(parts), checks)


def elsewhere(drives: Sequence[Elsewhere]) -> Section:
    """The same questions of other drives."""
    by_ratio, by_ckf = ("CKF", "ADLUKF", "AUKF"), ("ADLUKF", "ADLUKF printed")
    rows = [
        [
            drive.title,
            *(slashed(drive.ratio[name]) for name in by_ratio),
            *(slashed(drive.over_ckf[name]) for name in by_ckf),
        ]
        for drive in drives
    ]
    head = [
        "v_x / yaw rate",
        *(f"{n}: RMSE(2 I) / RMSE(0.01 I)" for n in by_ratio),
        *(f"{n} over CKF, true R" for n in by_ckf),
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


def logged_drives(
    logged: Logged,
    of_models: Mapping[str, Mapping[str, np.ndarray]],
    traces: Sequence[StateTrace],
) -> Section:
    """Figure 9, and what identification found."""
    models, filters = (
        [
            [
                row,
                *(
                    f"{side_slip_rmse_deg(logged.drives[name].drive, found[row]):.3f}"
                    for name, found in zip(DRIVEN, by_drive, strict=True)
                ),
            ]
            for row in by_drive[0]
        ]
        for by_drive in ([of_models[name] for name in DRIVEN], [one.estimates for one in traces])
    )
    linear, tanh = logged.linear, logged.tanh
    parts = [
        "The paper's Volkswagen Santana and its data are not public. In their place stands a "
        "simulated Ford Escort whose drives were written to CSV with the noise of their sensors "
        "(the folders `drive-*` beside this report), read again, and identified from the "
        f"{IDENTIFIED_FROM} drive as a user's log would be: linear tyres {_kilonewtons(linear)}, "
        f"saturating tyres {_kilonewtons(tanh)} with friction {tanh.car.friction:.2f} ± "
        f"{tanh.friction_std:.2f}. So this shows the way, and proves nothing about real cars.",
        "![figure-9.png](figure-9.png)",
        markdown_table(["RMSE of the side slip [°], CKF", *MANOEUVRES], models),
        "With the identified linear tyres:",
        markdown_table(["RMSE of the side slip [°]", *MANOEUVRES], filters),
    ]
    return Section(120, "Figure 9: logged drives", "\n\n".join(parts))


def _kilonewtons(found: Identified) -> str:
    front, rear = found.car.front_stiffness_n_rad / 1e3, found.car.rear_stiffness_n_rad / 1e3
    return f"{front:.0f} and {rear:.0f} kN/rad"


# --- the verdict ---------------------------------------------------------------------------------

_JUDGED_CASES = ("true R", "0.01 I", "2 I", "growing", "outliers")
_BEYOND_ONE = (
    (above, "ADLUKF", "over CKF at the true R", "true R", "v_x", 1),
    *(
        (below, name, f"over CKF, {case}", case, state, 1)
        for name in ("ADLUKF", "AUKF")
        for case in ("2 I", "growing")
        for state in ("v_x", "yaw rate")
    ),
    (below, "ADLUKF", "over CKF, 0.01 I", "0.01 I", "yaw rate", 1),
    (above, "ADLUKF", "over CKF with outliers", "outliers", "v_x", 1),
    *(
        (below, "MCUKF", "over CKF with outliers", "outliers", state, 0.6)
        for state in ("v_x", "yaw rate")
    ),
)


def in_plain_words(
    results: ScoresByFilter,
    nees: Mapping[str, np.ndarray],
    ukf_minus_ckf: Mapping[str, float],
    others: Sequence[Elsewhere],
) -> Section:
    """Return the verdict. Each sentence that judges has its checks below."""
    every = range(len(MANOEUVRES))

    def worst(name: str, case: str, state: str) -> Interval:
        return max(over_ckf(results, name, m, state, case) for m in every)

    def span(name: str, case: str) -> str:
        return slashed(worst(name, case, state).value for state in JUDGED)

    with_layer, without = (
        max(ratio(results, name, m, "v_x").value for m in every) for name in ("ADLUKF", "AUKF")
    )
    lines = [
        f"With the right R the ADLUKF does not win: {span('ADLUKF', 'true R')} times the CKF's "
        "RMSE.",
        f"In v_x and yaw rate it does with R0 = 2 I, {span('ADLUKF', '2 I')}, and with "
        f"noise that grows fourfold, {span('ADLUKF', 'growing')}; with R0 = 0.01 I in "
        f"the yaw rate alone, {span('ADLUKF', '0.01 I')}. That merit is real, if R alone "
        "is adapted, in residual form, within absolute bounds.",
        "It is the adaptation's merit. The same adaptation on a plain UKF (AUKF) costs a fraction "
        f"and has {span('AUKF', '2 I')} and {span('AUKF', 'growing')}. What "
        "the inner layer adds is gain, which forgets a wrong start sooner: RMSE(2 I) / RMSE(0.01 I)"
        f" of v_x is {with_layer:.2f} with it and {without:.2f} without.",
        "The inner layer counts every reading twice: average NEES "
        f"{nees['DLUKF'].mean():.1f} instead of 3 (UKF {nees['UKF'].mean():.2f}). Made consistent "
        f"it gives the UKF back ({nees['DLUKF consistent'].mean():.2f}).",
        "The filter as printed (Q and R, |diag|) has "
        f"{span('ADLUKF printed', 'true R')} at the right R; with the means q and r "
        f"{span('ADLUKF printed, q r', 'true R')}.",
        "UKF and CKF are one filter here: with the right R no state differs by more than "
        f"{ukf_minus_ckf['true R']:.0e}, with R0 = 2 I by {ukf_minus_ckf['2 I']:.0e} (rad/s, rad, "
        "m/s).",
        "Adaptation takes outliers for noise: with 2 % of them the ADLUKF has "
        f"{span('ADLUKF', 'outliers')}. Maximum correntropy ignores them: "
        f"{span('MCUKF', 'outliers')}.",
        "The side slip hardly depends on the filter; its error is that of the tyre model.",
        in_words(others),
    ]
    text = "\n".join(f"{number}. {line}" for number, line in enumerate(lines, start=1))
    rows = [[name, *(span(name, case) for case in _JUDGED_CASES)] for name in SHOWN[1:]]
    text += (
        "\n\nThree numbers in a row are the RMSE of v_x, side slip and yaw rate over the CKF's in "
        "the same case, the worse of the two manoeuvres. Sentences 1 to 8 are of one car in two "
        "manoeuvres; all of one simulator and one Q. Nothing is claimed beyond that.\n\n"
        + markdown_table(["over the CKF", *_JUDGED_CASES], rows)
    )
    checks = [
        form(f"{name} {words}, {state}", worst(name, case, state), bound)
        for form, name, words, case, state, bound in _BEYOND_ONE
    ]
    return Section(10, "What holds, in plain words", text, checks, shown=True)
