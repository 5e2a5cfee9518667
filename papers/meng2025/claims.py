"""The claims of Meng et al. (2025), each beside what was measured, and the errata of the paper."""

from types import SimpleNamespace

import numpy as np

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.meng2025 import SYSTEM, paper_points
from concord.features.measurement_bus.stochastic_ukf import expected_cov
from concord.filters.gaussian import Gaussian
from concord.papers.kit.judging import Claim, Erratum, NamedFigures, errata_from, needs
from concord.papers.meng2025.runs import MeasuredBatch, SlotEstimates, ranks_of_printed_cov
from concord.papers.meng2025.table import EstimatorRow, difference, mse_by_step, trace_by_step
from concord.results.figures.intervals import Interval

# Where the covariance of the printed filter ignores what was sent, it does so to rounding.
_ROUNDING = 1e-6


def gather(
    batch: MeasuredBatch, outcomes: dict[str, SlotEstimates], rows: dict[str, EstimatorRow]
) -> NamedFigures:
    """The figures that the claims need."""
    ranks = ranks_of_printed_cov(batch)
    printed = outcomes["paper-literal"]
    before = zip(printed.mean[:-1], printed.cov[:-1], strict=True)
    noise_cov = [
        SYSTEM.process_noise_cov(step)
        + expected_cov(SYSTEM.process_moment(step), Gaussian(*belief))
        for step, belief in enumerate(before)
    ]
    return {
        # Size of P_yy of (19), its least and largest rank; how many updates.
        "entries": SYSTEM.entries,
        "ranks": (int(ranks.min()), int(ranks.max())),
        "updates": ranks.size,
        # Largest |P - (Q + E(g g'))| of the printed filter after an update.
        "unheard": float(np.abs(printed.cov[1:] - np.stack(noise_cov)).max()),
        "printed_over_prediction": difference(batch, printed, outcomes["prediction"]),
        # Share of the steps at which the MSE is above tr P, by filter.
        "above_reported": {
            name: float(
                (mse_by_step(batch, outcomes[name]) > trace_by_step(outcomes[name]))[1:].mean()
            )
            for name in ("paper-literal", "recommended")
        },
        # MSE without E(g g') and E(b b') minus that of the recommended filter.
        "ignorance": _known(rows["ignorant"]),
        # MSE under other schedules minus that under FlexRay.
        "schedules": {name: _known(rows[name]) for name in ("wtodp", "round-robin", "rrp")},
        "rows": rows,
    }


def claims(evidence: NamedFigures) -> list[Claim]:
    """The claims with their verdicts."""
    e = SimpleNamespace(**evidence)
    rows, above = e.rows, e.above_reported
    ours, ignorant = rows["recommended"].anees, rows["ignorant"].anees
    assert ours is not None and ignorant is not None, "both report a covariance"
    compared = ", ".join(f"{rows[name].label} {_signed(by)}" for name, by in e.schedules.items())
    return [
        Claim("(19), (23)", "the gain is P_xy P_yy^-1",
            [needs(e.ranks[1], at_least=e.entries)],
            f"P_yy is {e.entries} x {e.entries}, its rank {e.ranks[0]} to {e.ranks[1]} in "
            f"{e.updates} updates: no inverse exists; paper-literal takes a pseudo-inverse", 1,
            "print against print"),
        Claim("sections 1, 3", "the impact of the protocol is reflected in the filter",
            [needs(e.unheard, at_least=_ROUNDING)],
            f"as printed, P after each update is Q + E(g g') to {e.unheard:.1e}, whatever was "
            "sent: the fresh sample has no gain", 1),
        Claim("section 4, Figures 2 and 3", "the estimates follow the states",
            [needs(e.printed_over_prediction, at_most=0.0)],
            f"RMSE {_pair(rows['paper-literal'])} as printed, {_pair(rows['prediction'])} without "
            f"any measurement, {_pair(rows['recommended'])} recommended, "
            f"{_pair(rows['particles'])} particle filter", 4),
        Claim("section 4, Figure 4", "log MSE is consistently below the log of its upper bound",
            [needs(share, at_most=0.0) for share in above.values()],
            "no bound is derived; the nearest is tr P, an estimate. The MSE over runs is above it "
            f"at {100 * above['paper-literal']:.0f} % of the steps as printed, at "
            f"{100 * above['recommended']:.0f} % with the recommended filter (half is what a "
            "calibrated one must give)", 13),
        Claim("sections 1, 3",
            "the impact of the stochastic nonlinearities is reflected in the filter",
            [needs(e.ignorance, at_least=0.0)],
            f"recommended filter without E(g g') and E(b b'): MSE {_signed(e.ignorance)}, "
            f"ANEES {ignorant.value:.2f} instead of {ours.value:.2f}", 6),
        Claim("section 1", "FlexRay has advantages over other protocols",
            [needs(by, at_least=0.0) for by in e.schedules.values()],
            f"MSE against FlexRay on the same runs: {compared}"),
    ]  # fmt: skip


def _pair(row: EstimatorRow) -> str:
    return "/".join(f"{rmse.value:.3f}" for rmse in row.rmse)


def _known(row: EstimatorRow) -> Interval:
    assert row.difference is not None, "the first row is what others are compared with"
    return row.difference


def _signed(one: Interval) -> str:
    return f"{one.value:+.4f} ± {(one.high - one.low) / 2:.4f}"


# --- errata --------------------------------------------------------------------------------------

PRINTED = (
    ("(19)", "P_yy with noise on the fresh rows alone", "singular beyond 2n + 1 entries"),
    ("(17), (18)", "held rows predicted for another instant",
     "the held value is known, and belongs in the place of both"),
    ("(19)", "held values without noise", "the noise that is in a held value"),
    ("(20)", "points without process noise paired with points with it",
     "redraw the points; the pairing depends on the choice of the root of P"),
    ("(15)", "ybar and the predictions of step 0", "undefined; here those of the prior"),
    ("(13), (19)", "E(g g') and E(b b')", "Pi (x' Gamma x + tr(Gamma P))"),
    ("(2)", "q; R_1 as a set of two", "q = ceil(s / l1)"),
    ("(3)", "Phi for scalar sensors", "blocks for sensors that measure vectors"),
    ("(4)", "weights; ties", "not given; here the identity, and the lowest node"),
    ("(1)", "the time of f and h", "f: of the state it moves; h: of the state it sees"),
    ("Remark 1", "smaller alpha and gamma decrease the complexity",
     "the points are as many; alpha = 0 is admitted and divides by zero"),
    ("section 4", "the index of the MSE", "undefined; here the mean over runs at each step"),
    ("Figure 4", "an upper bound of the MSE", "derived nowhere; the nearest is tr P"),
    ("section 4", "the initial state", "not given; here drawn from the prior"),
    ("(10)", "the root of P",
     "rows or columns is not said; here columns of the lower Cholesky factor"),
    ("section 4", "data transmission is effectively reduced", "by construction"),
)  # fmt: skip


def errata(recommended: SlotEstimates, rows: dict[str, EstimatorRow]) -> list[Erratum]:
    """The list, with figures where a figure belongs to an erratum."""
    ours, every = rows["recommended"].mse.value, rows["all"].mse.value
    points = " and ".join(str(len(paper_points(alpha).unit_points)) for alpha in (1.0, 0.1))
    added = {
        7: f"; then the slots are {order_of_slots(recommended, 10)}",
        11: f"; {points} of them for alpha 1 and 0.1",
        16: f": {100 * recommended.sent.mean():.1f} % of the measurements are sent; with all of "
        f"them the mean square error is smaller by a factor of {ours / every:.1f}",
    }
    return errata_from(PRINTED, added)


def order_of_slots(outcome: SlotEstimates, slots: int) -> str:
    """Senders of the first slots, the same in every run; d where runs contended."""
    names = []
    for sent in outcome.sent[:slots]:
        sensors = {int(sensor) + 1 for sensor in sent.argmax(axis=-1)}
        contended = min(sensors) > meng2025.STATIC_SLOTS
        names.append("d" if contended else ",".join(map(str, sorted(sensors))))
    return " ".join(names)
