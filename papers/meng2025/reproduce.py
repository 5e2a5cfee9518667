"""`concord reproduce meng2025`: the UKF under the FlexRay protocol, its figures and its claims."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from concord.papers.kit.figures import save_all, write_traces
from concord.papers.kit.judging import Check, above, agrees, at_most, below
from concord.papers.kit.report import Paper, Section, markdown_table
from concord.papers.kit.side_by_side import by_name
from concord.papers.meng2025.ablation import ablations
from concord.papers.meng2025.claims import claims, errata, gather, order_of_slots
from concord.papers.meng2025.figures import figures
from concord.papers.meng2025.particles import PARTICLES, track
from concord.papers.meng2025.posterior_bound import bound_of
from concord.papers.meng2025.runs import (
    MeasuredBatch,
    SlotEstimates,
    carry_out,
    methods,
    simulate,
    transmit,
)
from concord.papers.meng2025.table import EstimatorRow, row
from concord.results.figures.intervals import Interval

RUNS, STEPS = 200, 100
# Number of runs of an independent implementation, and the rounding of its printed figures.
_STUDY_RUNS, _ROUNDING = 200, {"RMSE": 0.0005, "ANEES": 0.005}
RECOMMENDED_RMSE, RECOMMENDED_ANEES, PARTICLE_RMSE = (0.243, 0.220), 2.06, (0.237, 0.215)
REFERENCE = "recommended"


def _carry_out(batch: MeasuredBatch, name: str) -> SlotEstimates:
    return carry_out(batch, methods()[name])


def _sections(folder: Path, seed: int, runs: int) -> Iterator[Section]:
    batch = simulate(seed, runs, STEPS)
    compared = methods()
    outcomes = by_name("methods", partial(_carry_out, batch), compared)
    labels = {name: method.label for name, method in compared.items()}
    drawn = figures(batch, outcomes[REFERENCE], outcomes["paper-literal"])
    yield Section(3, "Figures", save_all(drawn, folder, first=2))
    outcomes["particles"] = track(batch, compared[REFERENCE].schedule)
    labels["particles"] = f"FlexRay, particle filter ({PARTICLES})"
    _write(folder, batch, outcomes)
    reference = outcomes[REFERENCE]
    rows = {
        name: row(name, labels[name], batch, outcome, None if outcome is reference else reference)
        for name, outcome in outcomes.items()
    }
    # A cloud that is down to a few particles has a covariance of next to nothing.
    rows["particles"] = msgspec.structs.replace(
        rows["particles"], anees=None, coverage=None, mse_to_trace=None
    )
    yield _comparison(batch, rows)
    yield _ablation(batch, reference, rows[REFERENCE])
    yield Section(1, "Claims", claims=claims(gather(batch, outcomes, rows)))
    yield Section(2, "Errata", errata=errata(reference, rows))
    order = order_of_slots(reference, 10)
    slots = Check("order of the first slots", _ORDER, order, order == _ORDER)
    yield Section(5, "Checks", checks=[*checks_of(runs, rows), slots])


PAPER = Paper(
    "Unscented Kalman filtering under the FlexRay protocol (Meng et al. 2025)",
    seed=1,
    runs=RUNS,
    least_runs=2,
    because="so that runs can be compared",
    sections=_sections,
)


def _write(folder: Path, batch: MeasuredBatch, outcomes: dict[str, SlotEstimates]) -> None:
    axes = ("step", "run", "state")
    mean, cov = (np.stack([one[place] for one in outcomes.values()]) for place in (0, 1))
    variables = {
        "truth": (axes, batch.truth),
        "measurement": (("step", "run", "sensor"), batch.measurement),
        "mean": (("estimator", *axes), mean),
        "cov": (("estimator", *axes, "state_too"), cov),
    }
    write_traces(folder, variables, {"estimator": list(outcomes)})


# --- the comparison ------------------------------------------------------------------------------

_HEAD = (
    "estimator", "RMSE x1", "RMSE x2", "ANEES", "coverage", "diverged", "MSE / tr P",
    "largest error", "MSE difference",
)  # fmt: skip
_EXPLAINED = """\
{runs} runs of {steps} steps, all rows on the same noise, with 95 % intervals over runs. ANEES is 2
for a consistent filter, coverage the share of errors inside the 95 % ellipse. Runs that diverged
(an error above 1000) are counted and left out. The last column is the mean square error minus that
of the first row, run by run: an interval without 0 is a significant difference.
"""


def _comparison(batch: MeasuredBatch, rows: dict[str, EstimatorRow]) -> Section:
    table = markdown_table(_HEAD, [_cells(one) for one in rows.values()])
    text = _EXPLAINED.format(runs=batch.runs, steps=STEPS) + "\n" + table
    data = {name: msgspec.to_builtins(one) for name, one in rows.items()}
    return Section(4, "Comparison", text, data={"rows": data})


def _cells(one: EstimatorRow) -> tuple[str, ...]:
    return (
        one.label,
        *(_words(rmse, 3) for rmse in one.rmse),
        _words(one.anees, 2),
        _words(one.coverage, 3),
        f"{one.diverged:.1%}",
        "" if one.mse_to_trace is None else f"{one.mse_to_trace:.3f}",
        f"{one.largest_error:.1f}",
        _words(one.difference, 4, sign="+"),
    )


def _words(one: Interval | None, decimals: int, sign: str = "") -> str:
    if one is None:
        return ""
    return f"{one.value:{sign}.{decimals}f} ± {(one.high - one.low) / 2:.{decimals}f}"


# --- one erratum at a time -----------------------------------------------------------------------

_ABLATION = """\
The recommended filter with one formula as printed, or one other misreading, on the same runs. The
last column is as above. The Cramer-Rao rows are bounds: no filter that takes the sent values alone
has a smaller error on average over runs. They leave out what a contention tells of its losers.
"""


def _ablation(batch: MeasuredBatch, reference: SlotEstimates, first: EstimatorRow) -> Section:
    found = [first]
    for name, method in ablations().items():
        found.append(row(name, method.label, batch, carry_out(batch, method), reference))
    bounds: dict[str, np.ndarray] = {}
    for name in (REFERENCE, "all"):
        method = methods()[name]
        label = method.label.removesuffix(", recommended")
        bounds[label] = bound_of(batch, transmit(batch, method.schedule).fresh)
    cells = [_cells(one) for one in found]
    for label, bound in bounds.items():
        of_states = np.sqrt(bound.mean(axis=0))
        blank = ("",) * (len(_HEAD) - 3)
        cells.append((f"Cramer-Rao bound, {label}", *(f"{one:.3f}" for one in of_states), *blank))
    text = _ABLATION + "\n" + markdown_table(_HEAD, cells)
    least = next(iter(bounds.values())).mean(axis=0).sum()
    checks = [above("recommended: MSE against the Cramer-Rao bound", first.mse, least)]
    data = {one.name: msgspec.to_builtins(one) for one in found}
    return Section(6, "One erratum at a time", text, checks, data={"rows": data})


# --- what must hold ------------------------------------------------------------------------------


def checks_of(runs: int, rows: dict[str, EstimatorRow]) -> list[Check]:
    """The figures of the independent implementation, in bands of the runs' own intervals."""
    ours, particles = rows[REFERENCE], rows["particles"]
    assert ours.anees is not None, "it reports a covariance"
    known = [
        *_known("recommended", ours, RECOMMENDED_RMSE),
        *_known("particle filter", particles, PARTICLE_RMSE),
        ("recommended: ANEES", ours.anees, RECOMMENDED_ANEES, _ROUNDING["ANEES"]),
    ]
    wtodp = rows["wtodp"].difference
    assert wtodp is not None, "the reference is the first row"
    printed, nothing = rows["paper-literal"].mse.value, rows["prediction"].mse.value
    return [
        *(
            agrees(name, figure, runs, value, of_runs=_STUDY_RUNS, rounding=rounding)
            for name, figure, value, rounding in known
        ),
        at_most("recommended: share of runs that diverged", ours.diverged, 0.0),
        above("paper-literal: MSE against that of prediction only", printed, nothing),
        below("WTODP on 1..6 minus FlexRay, MSE", wtodp, 0.0),
    ]


def _known(
    what: str, row: EstimatorRow, values: tuple[float, ...]
) -> list[tuple[str, Interval, float, float]]:
    return [
        (f"{what}: RMSE x{state}", figure, value, _ROUNDING["RMSE"])
        for state, (figure, value) in enumerate(zip(row.rmse, values, strict=True), start=1)
    ]


_ORDER = "1 2 3 4 d 1 2 3 4 d"
