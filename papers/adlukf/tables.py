"""Tables 1 to 4 of the ADLUKF paper beside what was measured, with intervals over the seeds."""

from collections.abc import Mapping, Sequence

import numpy as np

from concord.papers.adlukf.filters import CONTESTANTS
from concord.papers.adlukf.study import CASES, STATES, UNITS, ErrorScores
from concord.papers.kit.report import markdown_table
from concord.results.figures.intervals import mean_t, positive_mean_t

ScoresByFilter = dict[str, ErrorScores]
"""The scores of every filter by name."""

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


JUDGED = ("v_x", "side slip", "yaw rate")
"""The states of the filters; v_y follows from them."""


def case_index(name: str) -> int:
    """Where a case is among the lanes."""
    return list(CASES).index(name)


def state_index(name: str) -> int:
    """Where a state is in the scores."""
    return STATES.index(name)


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


def errors_table(results: ScoresByFilter, manoeuvre: int, case: str, filters: Sequence[str]) -> str:
    """MAE, RMSE and SD of a manoeuvre, a row per filter."""
    at = case_index(case)
    head = ["filter", *(f"{name} [{unit}]" for name, unit in zip(STATES, UNITS, strict=True))]
    rows = []
    for measure in ErrorScores._fields:
        for name in filters:
            values = getattr(results[name], measure)[manoeuvre, at]
            cells = [with_interval(values[:, i]) for i in range(len(STATES))]
            rows.append([f"{measure.upper()} {name}", *cells])
    return markdown_table(head, rows)


def against_ckf_table(results: ScoresByFilter, manoeuvre: int, filters: Sequence[str]) -> str:
    """By how many per cent the RMSE differs from the CKF's, paired by seed."""
    at = case_index("true R")
    reference = results["CKF"].rmse[manoeuvre, at]
    rows = []
    for name in filters:
        change = 100 * (results[name].rmse[manoeuvre, at] / reference - 1)
        rows.append([name, *(_signed(change[:, i]) for i in range(len(STATES)))])
    return markdown_table(["RMSE against the CKF, %", *STATES], rows)


def _signed(values: np.ndarray) -> str:
    mean, low, high = mean_t(values)
    half = (high - low) / 2
    return f"{mean:+.1f} ± {half:.1f}" if np.isfinite(half) else f"{mean:+.1f}"


def per_state(rows: Mapping[str, np.ndarray], what: str, manoeuvres: Sequence[str]) -> str:
    """A row for each of `rows`, factors (manoeuvres, 3) of the `JUDGED` states, to two places."""
    head = [f"{what} ({' / '.join(manoeuvres)})", *JUDGED]
    cells = {
        name: [" / ".join(f"{value:.2f}" for value in of_state) for of_state in factors.T]
        for name, factors in rows.items()
    }
    return markdown_table(head, [[name, *row] for name, row in cells.items()])


def table_2(results: ScoresByFilter, manoeuvres: Sequence[str]) -> str:
    """The paper's MAE and RMSE above ours; yaw rates in the paper's unit."""
    at = case_index("true R")
    rows = []
    for (measure, state, unit), printed in TABLE_2.items():
        scale = np.pi / 180 if unit == "rad/s" else 1.0
        what = f"{measure} {state} [{unit}]"
        rows.append([what, "paper", *(f"{value:g}" for value in printed)])
        for manoeuvre, title in enumerate(manoeuvres):
            values = [getattr(results[name], measure.lower())[manoeuvre, at] for name in COMPARED]
            cells = [with_interval(scale * v[:, state_index(state)]) for v in values]
            rows.append([what, title, *cells])
    return markdown_table(["", "", *COMPARED], rows)


def table_3(results: ScoresByFilter, manoeuvres: Sequence[str]) -> str:
    """RMSE with R0 = 0.01 I and 2 I and their ratio, the paper's side slip first."""
    head = ["", "R0 = 0.01 I", "R0 = 2 I", "ratio"]
    rows = [
        [f"paper, {name}, side slip", f"{low:g}", f"{high:g}", f"{high / low:.1f}"]
        for name, (low, high) in TABLE_3.items()
    ]
    for manoeuvre, title in enumerate(manoeuvres):
        for state in ("side slip", "yaw rate", "v_x"):
            for name in ("CKF", "FAUKF", "ADLUKF", "AUKF"):
                low, high = (
                    _rmse(results, name, manoeuvre, case, state) for case in ("0.01 I", "2 I")
                )
                unit = UNITS[state_index(state)]
                rows.append(
                    [
                        f"{title}, {name}, {state} [{unit}]",
                        with_interval(low),
                        with_interval(high),
                        f"{ratio(results, name, manoeuvre, state):.2f}",
                    ]
                )
    return markdown_table(head, rows)


def ratio(results: ScoresByFilter, name: str, manoeuvre: int, state: str) -> float:
    """RMSE with R0 = 2 I over RMSE with R0 = 0.01 I, pooled over the seeds."""
    low, high = (_rmse(results, name, manoeuvre, case, state) for case in ("0.01 I", "2 I"))
    return float(np.sqrt((high**2).mean() / (low**2).mean()))


def _rmse(results: ScoresByFilter, name: str, manoeuvre: int, case: str, state: str) -> np.ndarray:
    return results[name].rmse[manoeuvre, case_index(case), :, state_index(state)]


def table_4(
    results: ScoresByFilter, signal_sd: dict[str, np.ndarray], manoeuvres: Sequence[str]
) -> str:
    """The paper's SD beside that of the errors and that of the estimated signals themselves.

    `signal_sd` by filter: (manoeuvres, 4).
    """
    at = case_index("true R")
    head = ["", *COMPARED]
    rows = [
        [f"paper, {state} [{unit}]", *(f"{value:g}" for value in printed)]
        for (state, unit), printed in TABLE_4.items()
    ]
    for manoeuvre, title in enumerate(manoeuvres):
        for state in ("v_x", "side slip", "yaw rate"):
            i = state_index(state)
            errors = [with_interval(results[n].sd[manoeuvre, at, :, i]) for n in COMPARED]
            signals = [f"{signal_sd[n][manoeuvre, i]:.4g}" for n in COMPARED]
            rows.append([f"{title}, {state} [{UNITS[i]}], of the error", *errors])
            rows.append([f"{title}, {state} [{UNITS[i]}], of the estimate", *signals])
    return markdown_table(head, rows)


def cases_table(results: ScoresByFilter, manoeuvre: int, filters: Sequence[str]) -> str:
    """RMSE of v_x, side slip and yaw rate in every case, the least of each in bold."""
    states = ("v_x", "side slip", "yaw rate")
    places = [state_index(state) for state in states]
    cells = {name: results[name].rmse[manoeuvre].mean(axis=1)[:, places] for name in filters}
    least = np.min(list(cells.values()), axis=0)
    head = ["RMSE of " + ", ".join(states), *CASES]
    rows = [
        [
            name,
            *(
                " ".join(
                    f"**{value:.3f}**" if value <= 1.005 * best else f"{value:.3f}"
                    for value, best in zip(row, bests, strict=True)
                )
                for row, bests in zip(values, least, strict=True)
            ),
        ]
        for name, values in cells.items()
    ]
    return markdown_table(head, rows)


def filters_table() -> str:
    """The filters and what they are."""
    return markdown_table(
        ["filter", "what it is"], [[c.name, c.what] for c in CONTESTANTS.values()]
    )


def over_ckf(
    results: ScoresByFilter, name: str, manoeuvre: int, state: str, case: str = "true R"
) -> float:
    """RMSE of a filter over the CKF's in the same case, pooled over the seeds."""
    at, i = case_index(case), state_index(state)
    ours, reference = (results[n].rmse[manoeuvre, at, :, i] for n in (name, "CKF"))
    return float(np.sqrt((ours**2).mean() / (reference**2).mean()))
