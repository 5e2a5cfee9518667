"""`concord reproduce liu2021`: set membership over FlexRay: figures, tables, guarantee."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from concord.papers.kit.checks import Check, above, at_most, near
from concord.papers.kit.figures import save_all
from concord.papers.kit.report import Paper, Section, markdown_table
from concord.papers.kit.side_by_side import side_by_side
from concord.papers.kit.traces import write_traces
from concord.papers.liu2021.claims import claims, errata, gather
from concord.papers.liu2021.comparisons import STEPS, by_shape, by_slots, multipliers_apart
from concord.papers.liu2021.costs import Costs, measure
from concord.papers.liu2021.figures import figures
from concord.papers.liu2021.mutants import Mutant, mutant_of_rule, mutant_of_sign
from concord.papers.liu2021.runs import (
    ESTIMATORS,
    FAMILIES,
    BoundedEstimates,
    G,
    SequenceBatch,
    simulate,
)
from concord.papers.liu2021.tables import PUBLISHED, difference, gains_of_tables

CYCLES = 13
LONG_SEQUENCES, LONG_CYCLES = 20, 60
COMPARED_SEQUENCES = 20
# An independent implementation measured these traces on the paper's noise.
TRACES = (
    16.83, 13.05, 13.81, 22.89, 31.46, 14.37, 10.33, 13.31, 29.05, 16.06, 8.97, 9.38, 10.91,
)  # fmt: skip
_RELATIVE = 1e-3


def _sections(folder: Path, seed: int, sequences: int) -> Iterator[Section]:
    """`sequences`: beside the paper's own."""
    batch = simulate(seed, sequences, CYCLES)
    outcomes = _outcomes("estimators", batch)
    _write(folder, batch, outcomes)
    yield Section(3, "Figures", save_all(figures(batch, outcomes), folder, first=2))
    gains = gains_of_tables()
    yield _tables(gains, batch)
    flipped, wrong_rule = mutant_of_sign(batch), mutant_of_rule(seed, sequences, CYCLES)
    yield _guarantee(outcomes, flipped, wrong_rule)
    yield _traces(outcomes)
    long = simulate(seed, LONG_SEQUENCES, LONG_CYCLES)
    yield _long_runs(long, _outcomes("estimators on long runs", long))
    yield _comparisons(seed, min(sequences, COMPARED_SEQUENCES), batch, outcomes)
    yield _costs(measure(simulate(seed, 0, CYCLES)))
    evidence = gather(batch, outcomes["paper"], gains, flipped, wrong_rule)
    yield Section(1, "Claims", claims=claims(evidence))
    yield Section(2, "Errata", errata=errata(outcomes))


def _outcomes(title: str, batch: SequenceBatch) -> dict[str, BoundedEstimates]:
    names = list(ESTIMATORS)
    found = side_by_side(title, partial(_estimates, batch), names)
    return dict(zip(names, found, strict=True))


def _estimates(batch: SequenceBatch, name: str) -> BoundedEstimates:
    return ESTIMATORS[name](batch)


PAPER = Paper(
    "Recursive set-membership state estimation over a FlexRay network (Liu et al. 2021)",
    seed=1,
    runs=200,
    least_runs=1,
    because="noise sequences beside the paper's own",
    sections=_sections,
)


def _write(folder: Path, batch: SequenceBatch, outcomes: dict[str, BoundedEstimates]) -> None:
    variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
        "state": (("sequence", "step", "x"), batch.states)
    }
    for name, one in outcomes.items():
        time = "instant" if len(one.steps) > CYCLES else "cycle"
        name = name.replace("-", "_")
        variables[f"{name}_radius"] = ((time, "sequence"), one.radius)
        variables[f"{name}_trace"] = ((time, "sequence"), one.trace)
        variables[f"{name}_gap"] = ((time, "sequence"), one.gap)
        variables[f"{name}_centre"] = ((time, "sequence", "x"), one.centre)
        variables[f"{name}_half_width"] = ((time, "sequence", "x"), one.half_widths)
    write_traces(folder, variables, {})


# --- figures and tables --------------------------------------------------------------------------


_TABLES = """\
The gains L of the first three cycles (printed as t_1, t_2, t_3), where output 4 is forced to win
three times: the rule (5) lets {winners} win on the paper's data, and the tables need 4, 4, 4. Why
they differ where they do: Table I agrees to four decimals but for two entries below 0.0006 that are
printed as 0.0000. Table II depends on the state estimate through the terms of the losers, on a flat
optimum, and differs where it does; no choice of the estimate alone brings it closer, and a loose
tolerance of the solver is likely but not proven. Table III is further away than Table I for the
same reasons. Many entries below 0.0007 are printed as 0.0000.
"""


def _tables(gains: np.ndarray, batch: SequenceBatch) -> Section:
    apart = [difference(ours, printed) for ours, printed in zip(gains, PUBLISHED, strict=True)]
    rows = [
        (f"Table {numeral}", f"{one.largest:.2g}", f"{one.relative:.2%}")
        for numeral, one in zip(("I", "II", "III"), apart, strict=True)
    ]
    beside = "\n\n".join(
        f"Table {numeral}, ours (printed):\n\n" + _beside(ours, printed)
        for numeral, ours, printed in zip(("I", "II", "III"), gains, PUBLISHED, strict=True)
    )
    winners = batch.received.winner[0, :3] + 3
    text = _TABLES.format(winners=", ".join(map(str, winners)))
    head = ("table", "largest difference", "relative, Frobenius")
    checks = [
        at_most("Table I: largest difference", apart[0].largest, 6e-4),
        near("Table II: relative difference", apart[1].relative, 0.047, 0.005),
        at_most("Table III: largest difference", apart[2].largest, 2e-3),
    ]
    text = text + "\n" + markdown_table(head, rows) + "\n\n" + beside
    return Section(4, "Tables I to III", text, checks, data={"gains": gains.tolist()})


def _beside(ours: np.ndarray, printed: np.ndarray) -> str:
    rows = [
        (str(row + 1), *(f"{a:.4f} ({b:.4f})" for a, b in zip(*pair, strict=True)))
        for row, pair in enumerate(zip(ours, printed, strict=True))
    ]
    return markdown_table(("row", "y1", "y2", "y3", "y4"), rows)


# --- the guarantee -------------------------------------------------------------------------------


_GUARANTEE = """\
{count} sequences (the paper's, and others with noise from the families {families}; every other
initial state on the edge of its ball), {cycles} cycles each. A set holds the truth where e' P^+ e,
or the squared gauge of a zonotope, is at most 1. The sum of half-widths is of the state at the end
of a cycle; tr P of the paper's estimator and its fast and tight forms is over three steps, of the
fast-rate form over one.
"""
_MUTANTS = """\
Two mistakes show that this test can fail: the sign of Xi flipped, and winners by the largest Q y^2
(no reference to the held value), which is what the printed tables seem to have been made with.
Where the terms of such an estimator contradict each other no ellipsoid is left.
"""


def _guarantee(
    outcomes: dict[str, BoundedEstimates], flipped: Mutant, wrong_rule: Mutant
) -> Section:
    some = next(iter(outcomes.values()))
    text = _GUARANTEE.format(
        count=some.radius.shape[1], families=", ".join(FAMILIES), cycles=CYCLES
    )
    head = ("estimator", "sets", "outside", "largest", "mean tr P", "sum of half-widths")
    text += "\n" + markdown_table(head, [_row(name, one) for name, one in outcomes.items()])
    head = ("mistake", "outside", "no set left", "of instants", "sequences touched", "of")
    planted = {"sign of Xi flipped": flipped, "winners by Q y^2": wrong_rule}
    text += (
        "\n\n"
        + _MUTANTS
        + "\n"
        + markdown_table(
            head,
            [
                (name, *map(str, (m.outside, m.contradicted, m.instants, m.sequences, m.of)))
                for name, m in planted.items()
            ],
        )
    )
    checks = [
        at_most(f"{name}: sets that do not hold the truth", int(one.violations.sum()), 0)
        for name, one in outcomes.items()
    ]
    checks += [above(f"{name}: violations", m.outside, 0) for name, m in planted.items()]
    data = {name: {"violations": int(one.violations.sum())} for name, one in outcomes.items()}
    data |= {name: m._asdict() for name, m in planted.items()}
    return Section(5, "The guarantee", text, checks, data=data)


def _row(name: str, outcome: BoundedEstimates) -> tuple[str, ...]:
    ends = outcome.steps % G == 0
    trace = outcome.trace.mean()
    return (
        name,
        str(outcome.radius.size),
        str(int(outcome.violations.sum())),
        f"{outcome.radius.max():.9f}",
        "" if np.isnan(trace) else f"{trace:.2f}",
        f"{outcome.half_widths[ends].sum(-1).mean():.2f}",
    )


# --- sizes over time -----------------------------------------------------------------------------


def _traces(outcomes: dict[str, BoundedEstimates]) -> Section:
    by_cycle_ = {name: outcomes[name].trace[:, 0] for name in ("paper", "fast", "tight")}
    by_cycle_["fast-rate, last step"] = outcomes["fast-rate"].trace[G - 1 :: G, 0]
    rows = [(name, *(f"{value:.2f}" for value in values)) for name, values in by_cycle_.items()]
    widths = {
        name: one.half_widths[one.steps % G == 0][:, 0].sum(-1) for name, one in outcomes.items()
    }
    text = "tr P after each cycle on the paper's noise (of three steps; fast-rate: of one):\n\n"
    head = ("estimator", *(str(cycle + 1) for cycle in range(CYCLES)))
    text += markdown_table(head, rows)
    text += "\n\nSum of the half-widths of the state at the end of each cycle:\n\n"
    rows = [(name, *(f"{value:.2f}" for value in values)) for name, values in widths.items()]
    text += markdown_table(head, rows)
    ours = by_cycle_["paper"]
    checks = [
        near(f"tr P after cycle {k + 1}", value, expected, _RELATIVE * expected)
        for k, (value, expected) in enumerate(zip(ours, TRACES, strict=True))
    ]
    shrunk = outcomes["tight"].trace[-1] / outcomes["paper"].trace[-1]
    checks.append(at_most("tight: tr P at the end against the paper's, worst", shrunk.max(), 0.95))
    data = {name: values.tolist() for name, values in by_cycle_.items()}
    return Section(6, "Size over time", text, checks, data=data)


def _long_runs(batch: SequenceBatch, outcomes: dict[str, BoundedEstimates]) -> Section:
    largest = np.abs(batch.states).max()
    text = (
        f"{batch.sequences} sequences of {LONG_CYCLES} cycles: the unstable state reaches "
        f"{largest:.1e}. The sets do not grow with it, until the rounding of so large a state, "
        "which they contain, shows in them."
    )
    ends = {name: one.trace[-1].max() for name, one in outcomes.items()}
    head = ("estimator", "sets", "outside", "largest", "tr P, last, largest")
    rows = [
        (
            name, str(one.radius.size), str(int(one.violations.sum())), f"{one.radius.max():.9f}",
            "" if np.isnan(ends[name]) else f"{ends[name]:.1f}",
        )
        for name, one in outcomes.items()
    ]  # fmt: skip
    checks = [
        at_most(f"{name}, long runs: sets that do not hold the truth", int(one.violations.sum()), 0)
        for name, one in outcomes.items()
    ]
    return Section(7, "Long unstable runs", text + "\n\n" + markdown_table(head, rows), checks)


# --- comparisons ---------------------------------------------------------------------------------

_COMPARED = """\
The paper compares neither protocols nor bounds. Each figure is the sum of the half-widths of the
state at the end of a cycle, on average; "outside" counts sets of both estimators that miss the
state. Protocols: {sequences} sequences of {steps} steps beside the paper's. W: the paper's noise,
which W = 0.09 holds just.
"""


def _comparisons(
    seed: int, sequences: int, batch: SequenceBatch, outcomes: dict[str, BoundedEstimates]
) -> Section:
    slots, shapes = by_slots(seed, sequences), by_shape(batch)
    head = ("", "paper", "tight", "sets", "outside")
    text = _COMPARED.format(sequences=sequences, steps=STEPS)
    pairs = [*slots, *shapes]
    rows = [
        (
            one.label, f"{one.half_widths:.2f}", f"{other.half_widths:.2f}",
            str(one.sets + other.sets), str(one.outside + other.outside),
        )
        for one, other in pairs
    ]  # fmt: skip
    text += "\n" + markdown_table(head, rows)
    apart = multipliers_apart(batch, outcomes)
    first = next(iter(apart.values())).trace.mean()
    text += "\n\nA multiplier for each noise sample, and then the cut by the data:\n\n"
    text += markdown_table(
        ("estimator", "mean tr P", "of the paper's", "outside"),
        [
            (
                name, f"{one.trace.mean():.2f}", f"{one.trace.mean() / first:.2f}",
                str(int(one.violations.sum())),
            )
            for name, one in apart.items()
        ],
    )  # fmt: skip
    outside = sum(one.outside + other.outside for one, other in pairs)
    outside += sum(int(one.violations.sum()) for one in apart.values())
    return Section(
        9,
        "Protocols, bounds and multipliers",
        text,
        [at_most("comparisons: sets that do not hold the truth", outside, 0)],
        data={"cases": [[one._asdict(), other._asdict()] for one, other in pairs]},
    )


# --- the solver, and what it costs ---------------------------------------------------------------


def _costs(costs: Costs) -> Section:
    rows = [
        (name, f"{each:.3g}", f"{each * CYCLES:.3g}", "" if apart is None else f"{apart:.1e}")
        for name, each, apart in costs.rows
    ]
    text = (
        "One sequence at a time, on this machine, so to be read as ratios (the paper: 4087 ms for "
        "the example, 314 ms a cycle). The last column is how far tr P is from the exact form's, "
        "from the same ellipsoid before, at most.\n\n"
    )
    text += markdown_table(("method", "ms a cycle", "ms the example", "tr P apart"), rows)
    checks: list[Check] = []
    if costs.solver is None:
        text += "\n\nThe cross-check needs the extra `convex` (cvxpy and clarabel), not installed."
    else:
        checks.append(at_most("semidefinite solver: tr P apart, relative", costs.solver, 1e-5))
    return Section(8, "Cross-check and times", text, checks)
