"""The claims of Meng et al. (2025), each beside what was measured. Errata as in the errata list."""

from typing import NamedTuple

import numpy as np

from concord.features.measurement_bus.meng2025 import SYSTEM
from concord.features.measurement_bus.stochastic_ukf import expected_cov
from concord.filters.gaussian import Gaussian
from concord.papers.kit.claims import Claim, needs
from concord.papers.meng2025.runs import MeasuredBatch, SlotEstimates, ranks_of_printed_cov
from concord.papers.meng2025.table import EstimatorRow, difference, mse_by_step, trace_by_step
from concord.results.figures.intervals import Interval

# Where the covariance of the printed filter ignores what was sent, it does so to rounding.
_ROUNDING = 1e-6


class Meng2025Evidence(NamedTuple):
    """The figures that the claims stand or fall by.

    Attributes:
        entries, ranks: size of P_yy of (19), its least and largest rank; updates: how many.
        unheard: largest |P - (Q + E(g g'))| of the printed filter after an update.
        printed_over_prediction: mean square error as printed minus that of prediction alone.
        above_reported: share of the steps at which the MSE is above tr P, by filter.
        ignorance: MSE without E(g g') and E(b b') minus that of the recommended filter.
        schedules: MSE under other schedules minus that under FlexRay.
        rows: of the table, for the words.
    """

    entries: int
    ranks: tuple[int, int]
    updates: int
    unheard: float
    printed_over_prediction: Interval
    above_reported: dict[str, float]
    ignorance: Interval
    schedules: dict[str, Interval]
    rows: dict[str, EstimatorRow]


def gather(
    batch: MeasuredBatch, outcomes: dict[str, SlotEstimates], rows: dict[str, EstimatorRow]
) -> Meng2025Evidence:
    """Everything the claims need."""
    ranks = ranks_of_printed_cov(batch)
    return Meng2025Evidence(
        entries=SYSTEM.entries,
        ranks=(int(ranks.min()), int(ranks.max())),
        updates=ranks.size,
        unheard=_unheard(outcomes["paper-literal"]),
        printed_over_prediction=difference(
            batch, outcomes["paper-literal"], outcomes["prediction"]
        ),
        above_reported={
            name: float(
                (mse_by_step(batch, outcomes[name]) > trace_by_step(outcomes[name]))[1:].mean()
            )
            for name in ("paper-literal", "recommended")
        },
        ignorance=_known(rows["ignorant"]),
        schedules={name: _known(rows[name]) for name in ("wtodp", "round-robin", "rrp")},
        rows=rows,
    )


def claims(e: Meng2025Evidence) -> list[Claim]:
    """The claims with their verdicts."""
    rows, above = e.rows, e.above_reported
    ours, ignorant = rows["recommended"].anees, rows["ignorant"].anees
    assert ours is not None and ignorant is not None, "both report a covariance"
    compared = ", ".join(f"{rows[name].label} {_signed(by)}" for name, by in e.schedules.items())
    return [
        Claim(
            "(19), (23)",
            "the gain is P_xy P_yy^-1",
            [needs(e.ranks[1], at_least=e.entries)],
            f"P_yy is {e.entries} x {e.entries}, its rank {e.ranks[0]} to {e.ranks[1]} in "
            f"{e.updates} updates: no inverse exists; paper-literal takes a pseudo-inverse",
            1,
            "print against print",
        ),
        Claim(
            "sections 1, 3",
            "the impact of the protocol is reflected in the filter",
            [needs(e.unheard, at_least=_ROUNDING)],
            f"as printed, P after each update is Q + E(g g') to {e.unheard:.1e}, whatever was "
            "sent: the fresh sample has no gain",
            1,
        ),
        Claim(
            "section 4, Figures 2 and 3",
            "the estimates follow the states",
            [needs(e.printed_over_prediction, at_most=0.0)],
            f"RMSE {_pair(rows['paper-literal'])} as printed, {_pair(rows['prediction'])} without "
            f"any measurement, {_pair(rows['recommended'])} recommended, "
            f"{_pair(rows['particles'])} particle filter",
            4,
        ),
        Claim(
            "section 4, Figure 4",
            "log MSE is consistently below the log of its upper bound",
            [needs(share, at_most=0.0) for share in above.values()],
            "no bound is derived; the nearest is tr P, an estimate. The MSE over runs is above it "
            f"at {100 * above['paper-literal']:.0f} % of the steps as printed, at "
            f"{100 * above['recommended']:.0f} % with the recommended filter (half is what a "
            "calibrated one must give)",
            13,
        ),
        Claim(
            "sections 1, 3",
            "the impact of the stochastic nonlinearities is reflected in the filter",
            [needs(e.ignorance, at_least=0.0)],
            f"recommended filter without E(g g') and E(b b'): MSE {_signed(e.ignorance)}, "
            f"ANEES {ignorant.value:.2f} instead of {ours.value:.2f}",
            6,
        ),
        Claim(
            "section 1",
            "FlexRay has advantages over other protocols",
            [needs(by, at_least=0.0) for by in e.schedules.values()],
            f"MSE against FlexRay on the same runs: {compared}",
        ),
    ]


def _unheard(printed: SlotEstimates) -> float:
    cov = [
        SYSTEM.process_noise_cov(step)
        + expected_cov(SYSTEM.process_moment(step), Gaussian(mean, before))
        for step, (mean, before) in enumerate(zip(printed.mean[:-1], printed.cov[:-1], strict=True))
    ]
    return float(np.abs(printed.cov[1:] - np.stack(cov)).max())


def _pair(row: EstimatorRow) -> str:
    return "/".join(f"{rmse.value:.3f}" for rmse in row.rmse)


def _known(row: EstimatorRow) -> Interval:
    assert row.difference is not None, "the first row is what others are compared with"
    return row.difference


def _signed(one: Interval) -> str:
    return f"{one.value:+.4f} ± {(one.high - one.low) / 2:.4f}"
