"""What Meng et al. (2025) say, and what was measured. Errata as in docs/measurement_bus.md."""

import numpy as np

from experiments.reproduce_meng2025_runs import (
    Batch,
    Outcome,
    ranks_of_printed_cov,
)
from experiments.reproduce_meng2025_table import Interval, Row, mse_by_step, trace_by_step
from experiments.reproduce_report import Claim, Verdict
from filters.gaussian import Gaussian
from filters.stochastic_ukf import expected_cov
from plants import meng2025
from scenarios.meng2025 import SYSTEM, paper_points


def claims(batch: Batch, outcomes: dict[str, Outcome], rows: dict[str, Row]) -> list[Claim]:
    """The claims with their verdicts."""
    return [
        _inverse(batch),
        _protocol(outcomes["paper-literal"]),
        _performance(rows),
        _bound(batch, outcomes),
        _nonlinearities(rows),
        _turns(outcomes["recommended"]),
        _reduced(outcomes["recommended"], rows),
        _schedule(rows),
        _alpha(rows),
    ]


def order_of_slots(outcome: Outcome, slots: int) -> str:
    """Who sent in the first slots, the same in every run; d where runs contended."""
    names = []
    for sent in outcome.sent[:slots]:
        sensors = {int(sensor) + 1 for sensor in sent.argmax(axis=-1)}
        contended = min(sensors) > meng2025.STATIC_SLOTS
        names.append("d" if contended else ",".join(map(str, sorted(sensors))))
    return " ".join(names)


def _inverse(batch: Batch) -> Claim:
    ranks, m = ranks_of_printed_cov(batch), SYSTEM.entries
    verdict: Verdict = "not reproducible as printed" if ranks.max() < m else "reproduced"
    return Claim(
        "(19), (23)",
        "the gain is P_xy P_yy^-1",
        verdict,
        f"P_yy is {m} x {m}, its rank {ranks.min()} to {ranks.max()} in {ranks.size} updates: the "
        "inverse does not exist; paper-literal takes a pseudo-inverse",
        1,
    )


def _protocol(printed: Outcome) -> Claim:
    before = Gaussian(printed.mean[:-1], printed.cov[:-1])
    unheard = [
        SYSTEM.process_noise_cov(step)
        + expected_cov(SYSTEM.process_moment(step), Gaussian(before.mean[step], before.cov[step]))
        for step in range(len(before.mean))
    ]
    deviation = np.abs(printed.cov[1:] - np.stack(unheard)).max()
    verdict: Verdict = "wrong" if deviation < 1e-6 else "reproduced"
    return Claim(
        "sections 1, 3",
        "the impact of the protocol is reflected in the filter",
        verdict,
        f"as printed, P after each update is Q + E(g g') to {deviation:.1e}, whatever was sent: "
        "the fresh sample has no gain",
        1,
    )


def _performance(rows: dict[str, Row]) -> Claim:
    printed, ours, nothing = (rows[name] for name in ("paper-literal", "recommended", "prediction"))
    worse = printed.mse.low > nothing.mse.high
    return Claim(
        "section 4, Figures 2 and 3",
        "the estimates follow the states",
        "not reproducible as printed" if worse else "reproduced",
        f"RMSE {_pair(printed)} as printed, {_pair(nothing)} without any measurement, "
        f"{_pair(ours)} recommended, {_pair(rows['particles'])} particle filter",
        4,
    )


def _bound(batch: Batch, outcomes: dict[str, Outcome]) -> Claim:
    above = {
        name: (mse_by_step(batch, outcomes[name]) > trace_by_step(outcomes[name]))[1:].mean()
        for name in ("paper-literal", "recommended")
    }
    return Claim(
        "section 4, Figure 4",
        "log MSE is consistently below the log of its upper bound",
        "not reproducible as printed" if min(above.values()) > 0 else "reproduced",
        "no bound is derived; the nearest is tr P, an estimate. The MSE over runs is above it at "
        f"{100 * above['paper-literal']:.0f} % of the steps as printed, at "
        f"{100 * above['recommended']:.0f} % with the recommended filter (half is what a "
        "calibrated one must give)",
        13,
    )


def _nonlinearities(rows: dict[str, Row]) -> Claim:
    ours, ignorant = rows["recommended"].anees, rows["ignorant"]
    assert ours is not None and ignorant.anees is not None, "both report a covariance"
    helps = _known(ignorant).low > 0
    return Claim(
        "sections 1, 3",
        "the impact of the stochastic nonlinearities is reflected in the filter",
        "reproduced" if helps else "not reproducible as printed",
        f"recommended filter without E(g g') and E(b b'): MSE {_signed(_known(ignorant))}, "
        f"ANEES {ignorant.anees.value:.2f} instead of {ours.value:.2f}",
        6,
    )


def _turns(outcome: Outcome) -> Claim:
    order = order_of_slots(outcome, 10)
    return Claim(
        "(2), (4), Figure 5",
        "four sensors in turn, then one of the last two",
        "reproduced" if order == "1 2 3 4 d 1 2 3 4 d" else "not reproducible as printed",
        f"{order} in every run, with q = ceil(s / l1) in (2), which the paper does not say",
        7,
    )


def _reduced(outcome: Outcome, rows: dict[str, Row]) -> Claim:
    share = outcome.sent.mean()
    price = rows["recommended"].mse.value / rows["all"].mse.value
    return Claim(
        "section 4, Figure 5",
        "data transmission is effectively reduced",
        "reproduced" if share < 1 else "wrong",
        f"{100 * share:.1f} % of the measurements are sent; with all of them the mean square error "
        f"is smaller by a factor of {price:.1f}",
    )


def _schedule(rows: dict[str, Row]) -> Claim:
    wtodp = _known(rows["wtodp"])
    compared = ", ".join(
        f"{rows[name].label} {_signed(_known(rows[name]))}"
        for name in ("wtodp", "round-robin", "rrp")
    )
    return Claim(
        "section 1",
        "FlexRay has advantages over other protocols",
        "not reproducible as printed" if wtodp.high < 0 else "reproduced",
        f"MSE against FlexRay on the same runs: {compared}",
    )


def _alpha(rows: dict[str, Row]) -> Claim:
    counts = {len(paper_points(alpha).unit_points) for alpha in (1.0, 0.1)}
    return Claim(
        "Remark 1",
        "smaller alpha and gamma decrease the computational complexity",
        "wrong" if len(counts) == 1 else "reproduced",
        f"{counts.pop()} points for any alpha; with 0.1 instead of 1, RMSE {_pair(rows['alpha'])}, "
        f"MSE {_signed(_known(rows['alpha']))}",
        11,
    )


def _pair(row: Row) -> str:
    return "/".join(f"{rmse.value:.3f}" for rmse in row.rmse)


def _known(row: Row) -> Interval:
    assert row.difference is not None, "the first row is what others are compared with"
    return row.difference


def _signed(one: Interval) -> str:
    return f"{one.value:+.4f} ± {(one.high - one.low) / 2:.4f}"
