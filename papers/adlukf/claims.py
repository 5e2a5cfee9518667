"""The claims of the ADLUKF paper, each beside what was measured."""

from collections.abc import Iterable, Mapping
from types import SimpleNamespace

import numpy as np

from concord.features.vehicle.plant.drive import Drive
from concord.papers.adlukf.sections import (
    COMPARED,
    TABLE_1_S,
    TABLE_2,
    TABLE_3,
    TABLE_4,
    unit_of,
)
from concord.papers.adlukf.study import (
    JUDGED,
    MANOEUVRES,
    STATES,
    FilterCost,
    ScoresByFilter,
    each_seed,
)
from concord.papers.kit.judging import Claim, NamedFigures, errata_from, needs
from concord.results.figures.intervals import Interval, mean_t, ratio_t

RIVALS = ("CKF", "FAUKF")
# A filter whose RMSE changes by a fifth is sensitive no more; one that changes by 1.3 is.
INSENSITIVE, SENSITIVE = (0.8, 1.2), 1.3
# Of a printed factor of 41, one that deserves the name.
_TENFOLD = 10.0
_BEST = {
    ("rmse", "yaw rate"): "the ADLUKF estimates the yaw rate best",
    ("rmse", "side slip"): "the ADLUKF estimates side slip and v_y best",
    ("mae", "v_x"): "the ADLUKF's mean absolute error of v_x is least",
}
# Printed figures. v_x in m/s: RMSE and MAE of the ADLUKF and the CKF, and the CKF's SD. The CKF's
# yaw rate in deg/s: its mean error and its SD.
PRINTED = {
    "adlukf_rmse": TABLE_2["RMSE", "v_x", "m/s"][2],
    "adlukf_mae": TABLE_2["MAE", "v_x", "m/s"][2],
    "ckf_rmse": TABLE_2["RMSE", "v_x", "m/s"][0],
    "ckf_mae": TABLE_2["MAE", "v_x", "m/s"][0],
    "ckf_sd": TABLE_4["v_x", "m/s"][0],
    "yaw_error_deg_s": float(np.degrees(TABLE_2["MAE", "yaw rate", "rad/s"][0])),
    "yaw_sd_deg_s": float(np.degrees(TABLE_4["yaw rate", "rad/s"][0])),
    "printed_cost": TABLE_1_S["ADLUKF"] / TABLE_1_S["CKF"],
}


def gather(
    results: ScoresByFilter,
    drives: tuple[Drive, ...],
    signal_sd: Mapping[str, np.ndarray],
    of_filters: Mapping[str, FilterCost],
    failed_lanes: Mapping[str, int],
) -> NamedFigures:
    """The figures that the claims need; tuples are over manoeuvres, then over states."""
    manoeuvres = range(len(MANOEUVRES))
    ours, reference = of_filters["ADLUKF"], of_filters["CKF"]
    yaw = STATES.index("yaw rate")

    def ratios(name: str, *states: str) -> tuple[Interval, ...]:
        """RMSE(2 I) / RMSE(0.01 I)."""
        return _ratios(
            [each_seed(results[name], "rmse", s, case) for case in ("2 I", "0.01 I")]
            for s in states
        )

    best = {key: {n: each_seed(results[n], *key) for n in COMPARED} for key in _BEST}
    return {
        **PRINTED,
        # Error of the ADLUKF minus that of each rival.
        "beaten": {
            key: tuple(mean_t(of["ADLUKF"][m] - of[r][m]) for m in manoeuvres for r in RIVALS)
            for key, of in best.items()
        },
        "mean": {
            key: "; ".join(
                f"{title}: " + ", ".join(f"{n} {values[m].mean():.3g}" for n, values in of.items())
                for m, title in enumerate(MANOEUVRES)
            )
            for key, of in best.items()
        },
        # In deg/s: the CKF's mean absolute error, the mean absolute value, and the largest SD of
        # what a filter estimates.
        "yaw_error": tuple(each_seed(results["CKF"], "mae", "yaw rate").mean(axis=1).tolist()),
        "yaw_signal": tuple(float(np.degrees(np.abs(d.yaw_rate_rad_s)).mean()) for d in drives),
        "yaw_spread": tuple(
            float(max(signal_sd[name][m, yaw] for name in COMPARED)) for m in manoeuvres
        ),
        "adlukf_ratio": ratios("ADLUKF", "v_x", "yaw rate"),
        "ckf_ratio": ratios("CKF", "v_x", "yaw rate"),
        "ckf_side_slip_ratio": ratios("CKF", "side slip"),
        # Of the ADLUKF over those of the CKF.
        "evaluations": ours.evaluations / reference.evaluations,
        "seconds": ours.seconds / reference.seconds,
        # Runs that lost positive definiteness.
        "ckf_lost": failed_lanes["CKF"],
        "all_lost": sum(failed_lanes.values()),
        "printed_over_ckf": _ratios(
            [each_seed(results[n], "rmse", state) for n in ("ADLUKF printed", "CKF")]
            for state in JUDGED
        ),
    }


def _ratios(pairs: Iterable[list[np.ndarray]]) -> tuple[Interval, ...]:
    """Ratios of pairs of RMSE (manoeuvres, seeds), by manoeuvre and then by pair."""
    kept = list(pairs)
    return tuple(
        ratio_t(one[m] ** 2, other[m] ** 2) for m in range(len(MANOEUVRES)) for one, other in kept
    )


def claims(evidence: NamedFigures) -> list[Claim]:
    """In the order of the paper."""
    e = SimpleNamespace(**evidence)
    return [*_errors(e), *_sensitivity(e), *_rest(e)]


def _errors(e: SimpleNamespace) -> list[Claim]:
    ours, signal = e.yaw_error, e.yaw_signal
    return [
        *(
            Claim(
                "4.1.1, 4.1.2, Table 2", says,
                [needs(difference, at_most=0.0) for difference in e.beaten[key]],
                f"{key[0].upper()} [{unit_of(key[1])}], R known; {e.mean[key]}",
            )
            for key, says in _BEST.items()
        ),
        Claim("Table 2",
            f"the ADLUKF's v_x has an RMSE of {e.adlukf_rmse} with an MAE of {e.adlukf_mae}",
            [needs(e.adlukf_rmse, at_least=e.adlukf_mae)],
            "no set of errors has an RMSE below its MAE", test="print against print"),
        Claim("Table 2",
            f"the CKF errs by {e.yaw_error_deg_s:.0f} deg/s in the yaw rate on average",
            [needs(mean, at_least=e.yaw_error_deg_s) for mean in signal],
            f"{ours[0]:.3f} and {ours[1]:.3f} deg/s; to guess 0 all the way would err by "
            f"{signal[0]:.1f} and {signal[1]:.1f} deg/s"),
    ]  # fmt: skip


def _sensitivity(e: SimpleNamespace) -> list[Claim]:
    low, high = INSENSITIVE
    return [
        Claim("Table 3", "the CKF is sensitive to the starting R, the ADLUKF is not",
            [
                *(needs(ratio, at_least=low, at_most=high) for ratio in e.adlukf_ratio),
                *(needs(ratio, at_least=SENSITIVE) for ratio in e.ckf_ratio),
            ],
            "RMSE(2 I) / RMSE(0.01 I) of v_x and yaw rate: ADLUKF "
            f"{_values(e.adlukf_ratio)} (within {low:g} and {high:g}). CKF {_values(e.ckf_ratio)} "
            f"(above {SENSITIVE:g})"),
        Claim("Table 3", "with R0 = 2 I instead of 0.01 I the CKF's side slip is 41 times worse",
            [needs(ratio, at_least=_TENFOLD) for ratio in e.ckf_side_slip_ratio],
            f"ratios {_values(e.ckf_side_slip_ratio)}: with a huge R the CKF runs open loop, and "
            "the side slip of the model alone is no worse", 2),
    ]  # fmt: skip


def _rest(e: SimpleNamespace) -> list[Claim]:
    bias = float(np.sqrt(max(e.ckf_rmse**2 - e.ckf_sd**2, 0.0)))
    best = min(ratio.value for ratio in e.printed_over_ckf)
    return [
        Claim("Table 4", f"the SD of the CKF's v_x is {e.ckf_sd}",
            [needs(bias, at_most=e.ckf_mae)],
            f"with the RMSE of {e.ckf_rmse} of Table 2 the mean error would be {bias:.3f}; the "
            f"mean absolute error, which bounds it, is {e.ckf_mae}", test="print against print"),
        Claim("Table 4", f"the SD of the yaw rate is {e.yaw_sd_deg_s:.0f} deg/s",
            [needs(spread, at_least=e.yaw_sd_deg_s) for spread in e.yaw_spread],
            f"of the estimated signal itself it is {e.yaw_spread[0]:.1f} and "
            f"{e.yaw_spread[1]:.1f} deg/s; if deg/s were meant, it would hardly depend on the "
            "filter and say nothing of errors"),
        Claim("Table 1",
            f"the ADLUKF costs {100 * (e.printed_cost - 1):.0f} % more time than the CKF",
            [needs(e.evaluations, at_most=2 * e.printed_cost)],
            f"{e.evaluations:.1f} times the model evaluations, {e.seconds:.1f} times the time here",
            3),
        Claim("4.2", "the CKF is distorted because its covariance is not positive definite",
            [needs(e.ckf_lost, at_least=1)],
            f"{e.ckf_lost} of the CKF's runs lost it ({e.all_lost} of all filters'); its weights "
            "are all positive"),
        Claim("3.3",
            "Sage-Husa adaptation of Q and R with |diag| reduces the influence of the noise",
            [needs(ratio, at_most=1.0) for ratio in e.printed_over_ckf],
            f"at the true R, {best:.2f} times the CKF's RMSE in the state where it is best: Q and "
            "R cannot be told apart from one innovation; R alone in residual form can"),
    ]  # fmt: skip


def _values(ratios: tuple[Interval, ...]) -> str:
    return ", ".join(f"{one.value:.2f} [{one.low:.2f}, {one.high:.2f}]" for one in ratios)


ERRATA = errata_from((
    ("section 3", "equations (6) to (35)",
     "lost in print; reconstructed in docs/papers/adlukf.md"),
    ("Table 3",
     "RMSE of the side slip, {:g} and {:g} for the CKF".format(*TABLE_3["CKF"]),
     "no unit is given"),
    ("Table 1", "times of a co-simulation", "a filter is the least part of them"),
))  # fmt: skip
