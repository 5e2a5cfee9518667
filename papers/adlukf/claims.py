"""The claims of the ADLUKF paper, each beside what was measured."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.papers.adlukf.cost import FilterCost
from concord.papers.adlukf.drives import DRIVEN
from concord.papers.adlukf.study import UNITS
from concord.papers.adlukf.tables import (
    COMPARED,
    JUDGED,
    TABLE_1_S,
    TABLE_2,
    TABLE_3,
    TABLE_4,
    ScoresByFilter,
    case_index,
    state_index,
)
from concord.papers.kit.claims import Claim, Erratum, needs
from concord.results.figures.intervals import Interval, mean_t, ratio_t

MANOEUVRES = tuple(name.replace("-", " ") for name in DRIVEN)
RIVALS = ("CKF", "FAUKF")
# A filter whose RMSE changes by a fifth is sensitive no more; one that changes by 1.3 is.
INSENSITIVE, SENSITIVE = (0.8, 1.2), 1.3
# Of a printed factor of 41, one that deserves the name.
_TENFOLD = 10.0


class Printed(NamedTuple):
    """Figures that the paper prints.

    v_x is in m/s: (RMSE, MAE) of the ADLUKF and (RMSE, SD, MAE) of the CKF. The yaw rate is in
    deg/s: the CKF's mean error and its SD.
    """

    adlukf_v_x: tuple[float, float]
    ckf_v_x: tuple[float, float, float]
    yaw_error_deg_s: float
    yaw_sd_deg_s: float


class AdlukfEvidence(NamedTuple):
    """The figures that the claims stand or fall by.

    Attributes:
        printed: what the paper prints.
        beaten: error of the ADLUKF minus that of each rival in each manoeuvre, by (measure, state).
        mean: the mean errors behind them, (filter, words), for the words.
        yaw_error, yaw_signal, yaw_spread: in deg/s by manoeuvre, the CKF's mean absolute error, the
            mean absolute value, and the largest SD of what a filter estimates.
        adlukf_ratio, ckf_ratio, ckf_side_slip_ratio: RMSE(2 I) / RMSE(0.01 I).
        cost: model evaluations and time of the ADLUKF over those of the CKF.
        printed_cost: the same of the paper's times.
        lost: runs in which the CKF lost positive definiteness, and any filter.
        printed_over_ckf: RMSE of the filter as printed over the CKF's, every state and manoeuvre.
    """

    printed: Printed
    beaten: dict[tuple[str, str], tuple[Interval, ...]]
    mean: dict[tuple[str, str], str]
    yaw_error: tuple[float, ...]
    yaw_signal: tuple[float, ...]
    yaw_spread: tuple[float, ...]
    adlukf_ratio: tuple[Interval, ...]
    ckf_ratio: tuple[Interval, ...]
    ckf_side_slip_ratio: tuple[Interval, ...]
    cost: tuple[float, float]
    printed_cost: float
    lost: tuple[int, int]
    printed_over_ckf: tuple[Interval, ...]


_BEST = {
    ("rmse", "yaw rate"): "the ADLUKF estimates the yaw rate best",
    ("rmse", "side slip"): "the ADLUKF estimates side slip and v_y best",
    ("mae", "v_x"): "the ADLUKF's mean absolute error of v_x is least",
}


def gather(
    results: ScoresByFilter,
    drives: tuple[Drive, ...],
    signal_sd: Mapping[str, np.ndarray],
    of_filters: Mapping[str, FilterCost],
    failed_lanes: Mapping[str, int],
) -> AdlukfEvidence:
    """Everything the claims need."""
    at, yaw = case_index("true R"), state_index("yaw rate")
    manoeuvres = range(len(MANOEUVRES))
    ours, reference = of_filters["ADLUKF"], of_filters["CKF"]
    return AdlukfEvidence(
        printed=Printed(
            (TABLE_2["RMSE", "v_x", "m/s"][2], TABLE_2["MAE", "v_x", "m/s"][2]),
            (
                TABLE_2["RMSE", "v_x", "m/s"][0],
                TABLE_4["v_x", "m/s"][0],
                TABLE_2["MAE", "v_x", "m/s"][0],
            ),
            float(np.degrees(TABLE_2["MAE", "yaw rate", "rad/s"][0])),
            float(np.degrees(TABLE_4["yaw rate", "rad/s"][0])),
        ),
        beaten={key: _beaten(results, *key) for key in _BEST},
        mean={key: _means(results, *key) for key in _BEST},
        yaw_error=tuple(float(results["CKF"].mae[m, at, :, yaw].mean()) for m in manoeuvres),
        yaw_signal=tuple(float(np.degrees(np.abs(d.yaw_rate_rad_s)).mean()) for d in drives),
        yaw_spread=tuple(
            float(max(signal_sd[name][m, yaw] for name in COMPARED)) for m in manoeuvres
        ),
        adlukf_ratio=_ratios(results, "ADLUKF", ("v_x", "yaw rate")),
        ckf_ratio=_ratios(results, "CKF", ("v_x", "yaw rate")),
        ckf_side_slip_ratio=_ratios(results, "CKF", ("side slip",)),
        cost=(ours.evaluations / reference.evaluations, ours.seconds / reference.seconds),
        printed_cost=TABLE_1_S["ADLUKF"] / TABLE_1_S["CKF"],
        lost=(failed_lanes["CKF"], sum(failed_lanes.values())),
        printed_over_ckf=tuple(
            ratio_t(
                results["ADLUKF printed"].rmse[m, at, :, state_index(state)] ** 2,
                results["CKF"].rmse[m, at, :, state_index(state)] ** 2,
            )
            for m in manoeuvres
            for state in JUDGED
        ),
    )


def claims(e: AdlukfEvidence) -> list[Claim]:
    """In the order of the paper."""
    return [*_errors(e), *_sensitivity(e), *_rest(e)]


def errata() -> list[Erratum]:
    """Return the errata: the printed text and its reading in this reproduction."""
    low, high = TABLE_3["CKF"]
    return [
        Erratum(
            1, "section 3", "equations (6) to (35)",
            "lost in print; reconstructed in docs/papers/adlukf.md",
        ),
        Erratum(
            2, "Table 3", f"RMSE of the side slip, {low:g} and {high:g} for the CKF",
            "no unit is given",
        ),
        Erratum(
            3, "Table 1", "times of a co-simulation", "a filter is the least part of them",
        ),
    ]  # fmt: skip


def _errors(e: AdlukfEvidence) -> list[Claim]:
    rmse, mae = e.printed.adlukf_v_x
    ours, signal = e.yaw_error, e.yaw_signal
    return [
        *(
            Claim(
                "4.1.1, 4.1.2, Table 2",
                says,
                [needs(difference, at_most=0.0) for difference in e.beaten[key]],
                f"{key[0].upper()} [{UNITS[state_index(key[1])]}], R known; {e.mean[key]}",
            )
            for key, says in _BEST.items()
        ),
        Claim(
            "Table 2",
            f"the ADLUKF's v_x has an RMSE of {rmse} with an MAE of {mae}",
            [needs(rmse, at_least=mae)],
            "no set of errors has an RMSE below its MAE",
            test="print against print",
        ),
        Claim(
            "Table 2",
            f"the CKF errs by {e.printed.yaw_error_deg_s:.0f} deg/s in the yaw rate on average",
            [needs(mean, at_least=e.printed.yaw_error_deg_s) for mean in signal],
            f"{ours[0]:.3f} and {ours[1]:.3f} deg/s; to guess 0 all the way would err by "
            f"{signal[0]:.1f} and {signal[1]:.1f} deg/s",
        ),
    ]


def _sensitivity(e: AdlukfEvidence) -> list[Claim]:
    slip = e.ckf_side_slip_ratio
    low, high = INSENSITIVE
    return [
        Claim(
            "Table 3",
            "the CKF is sensitive to the starting R, the ADLUKF is not",
            [
                *(needs(ratio, at_least=low, at_most=high) for ratio in e.adlukf_ratio),
                *(needs(ratio, at_least=SENSITIVE) for ratio in e.ckf_ratio),
            ],
            "RMSE(2 I) / RMSE(0.01 I) of v_x and yaw rate: ADLUKF "
            f"{_values(e.adlukf_ratio)} (within {low:g} and {high:g}), CKF {_values(e.ckf_ratio)} "
            f"(above {SENSITIVE:g})",
        ),
        Claim(
            "Table 3",
            "with R0 = 2 I instead of 0.01 I the CKF's side slip is 41 times worse",
            [needs(ratio, at_least=_TENFOLD) for ratio in slip],
            f"ratios {_values(slip)}: with a huge R the CKF runs open loop, and the side slip of "
            "the model alone is no worse",
            2,
        ),
    ]  # fmt: skip


def _rest(e: AdlukfEvidence) -> list[Claim]:
    rmse, sd, mae = e.printed.ckf_v_x
    bias = float(np.sqrt(max(rmse**2 - sd**2, 0.0)))
    best = min(ratio.value for ratio in e.printed_over_ckf)
    return [
        Claim(
            "Table 4",
            f"the SD of the CKF's v_x is {sd}",
            [needs(bias, at_most=mae)],
            f"with the RMSE of {rmse} of Table 2 the mean error would be {bias:.3f}; the mean "
            f"absolute error, which bounds it, is {mae}",
            test="print against print",
        ),
        Claim(
            "Table 4",
            f"the SD of the yaw rate is {e.printed.yaw_sd_deg_s:.0f} deg/s",
            [needs(spread, at_least=e.printed.yaw_sd_deg_s) for spread in e.yaw_spread],
            f"of the estimated signal itself it is {e.yaw_spread[0]:.1f} and "
            f"{e.yaw_spread[1]:.1f} deg/s; if deg/s were meant, it would hardly depend on the "
            "filter and say nothing of errors",
        ),
        Claim(
            "Table 1",
            f"the ADLUKF costs {100 * (e.printed_cost - 1):.0f} % more time than the CKF",
            [needs(e.cost[0], at_most=2 * e.printed_cost)],
            f"{e.cost[0]:.1f} times the model evaluations, {e.cost[1]:.1f} times the time here",
            3,
        ),
        Claim(
            "4.2",
            "the CKF is distorted because its covariance is not positive definite",
            [needs(e.lost[0], at_least=1)],
            f"{e.lost[0]} of the CKF's runs lost it ({e.lost[1]} of all filters'); its weights are "
            "all positive",
        ),
        Claim(
            "3.3",
            "Sage-Husa adaptation of Q and R with |diag| reduces the influence of the noise",
            [needs(ratio, at_most=1.0) for ratio in e.printed_over_ckf],
            f"at the true R, {best:.2f} times the CKF's RMSE in the state where it is best: Q and "
            "R cannot be told apart from one innovation; R alone in residual form can",
        ),
    ]


def _beaten(results: ScoresByFilter, measure: str, state: str) -> tuple[Interval, ...]:
    at, i = case_index("true R"), state_index(state)
    errors = {name: getattr(results[name], measure)[:, at, :, i] for name in COMPARED}
    return tuple(
        mean_t(errors["ADLUKF"][m] - errors[rival][m])
        for m in range(len(MANOEUVRES))
        for rival in RIVALS
    )


def _means(results: ScoresByFilter, measure: str, state: str) -> str:
    at, i = case_index("true R"), state_index(state)
    return "; ".join(
        f"{title}: "
        + ", ".join(
            f"{name} {getattr(results[name], measure)[m, at, :, i].mean():.3g}"
            for name in COMPARED
        )
        for m, title in enumerate(MANOEUVRES)
    )  # fmt: skip


def _ratios(results: ScoresByFilter, name: str, states: tuple[str, ...]) -> tuple[Interval, ...]:
    high, low = case_index("2 I"), case_index("0.01 I")
    squares = results[name].rmse ** 2
    return tuple(
        ratio_t(squares[m, high, :, state_index(state)], squares[m, low, :, state_index(state)])
        for m in range(len(MANOEUVRES))
        for state in states
    )


def _values(ratios: tuple[Interval, ...]) -> str:
    return ", ".join(f"{one.value:.2f} [{one.low:.2f}, {one.high:.2f}]" for one in ratios)
