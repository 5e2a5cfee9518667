"""`concord reproduce liu2021`: set membership over FlexRay: figures, tables, guarantee."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from concord.papers.kit.figures import save_all, write_traces
from concord.papers.kit.judging import Check, above, at_most, near
from concord.papers.kit.report import Paper, Section, markdown_table
from concord.papers.kit.side_by_side import by_name
from concord.papers.liu2021.claims import claims, errata, gather
from concord.papers.liu2021.comparisons import (
    STEPS,
    Mutant,
    by_shape,
    by_slots,
    multipliers_apart,
    mutant_of_rule,
    mutant_of_sign,
)
from concord.papers.liu2021.figures import figures
from concord.papers.liu2021.runs import (
    ESTIMATORS,
    FAMILIES,
    PRIOR_SHAPE,
    BoundedEstimates,
    G,
    SequenceBatch,
    simulate,
)
from concord.papers.liu2021.solver import Costs, measure
from concord.papers.liu2021.tables import PUBLISHED, difference, gains_of_tables

CYCLES = 13
LONG_SEQUENCES, LONG_CYCLES = 20, 60
COMPARED_SEQUENCES = 20
# An independent implementation measured these traces on the paper's noise.
TRACES = (
    16.83, 13.05, 13.81, 22.89, 31.46, 14.37, 10.33, 13.31, 29.05, 16.06, 8.97, 9.38, 10.91,
)  # fmt: skip
_RELATIVE = 1e-3
# Mean trace of the fast form on the paper's noise, as first measured here.
FAST_TRACE = 17.68895
EDGE_SEQUENCE = 2
"""The first sequence whose state begins on the edge of the ball."""


def _sections(folder: Path, seed: int, sequences: int) -> Iterator[Section]:
    """`sequences`: beside the paper's own."""
    batch = simulate(seed, sequences, CYCLES)
    outcomes = by_name("estimators", partial(_estimates, batch), ESTIMATORS)
    _write(folder, batch, outcomes)
    yield Section(3, "Figures", save_all(figures(batch, outcomes), folder, first=2))
    gains = gains_of_tables()
    yield _tables(gains, batch)
    flipped, wrong_rule = mutant_of_sign(batch), mutant_of_rule(seed, sequences, CYCLES)
    yield _guarantee(batch, outcomes, flipped, wrong_rule)
    yield _traces(outcomes)
    long = simulate(seed, LONG_SEQUENCES, LONG_CYCLES)
    outcomes_of_long = by_name("estimators on long runs", partial(_estimates, long), ESTIMATORS)
    yield _long_runs(long, outcomes_of_long)
    yield _comparisons(seed, min(sequences, COMPARED_SEQUENCES), batch, outcomes)
    yield _costs(measure(simulate(seed, 0, CYCLES)))
    evidence = gather(batch, outcomes["paper"], gains, flipped, wrong_rule)
    yield Section(1, "Claims", claims=claims(evidence))
    yield Section(2, "Errata", errata=errata(outcomes))


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
    kinds = {
        "radius": ("radius", ()), "trace": ("trace", ()), "gap": ("gap", ()),
        "centre": ("centre", ("x",)), "half_width": ("half_widths", ("x",)),
    }  # fmt: skip
    for name, one in outcomes.items():
        axes = ("instant" if len(one.steps) > CYCLES else "cycle", "sequence")
        for kind, (attribute, more) in kinds.items():
            variable = f"{name.replace('-', '_')}_{kind}"
            variables[variable] = ((*axes, *more), getattr(one, attribute))
    write_traces(folder, variables, {})


def _held(words: str, outcomes: dict[str, BoundedEstimates]) -> list[Check]:
    """Every set of every estimator holds the truth."""
    return [
        at_most(f"{name}{words}: sets that do not hold the truth", int(one.violations.sum()), 0)
        for name, one in outcomes.items()
    ]


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
    numerals = ("I", "II", "III")
    apart = [difference(ours, printed) for ours, printed in zip(gains, PUBLISHED, strict=True)]
    rows = [
        (f"Table {numeral}", f"{one.largest:.2g}", f"{one.relative:.2%}")
        for numeral, one in zip(numerals, apart, strict=True)
    ]
    winners = batch.received.winner[0, :3] + 3
    text = _TABLES.format(winners=", ".join(map(str, winners)))
    text += "\n" + markdown_table(("table", "largest difference", "relative, Frobenius"), rows)
    for numeral, ours, printed in zip(numerals, gains, PUBLISHED, strict=True):
        beside = [
            (str(row), *(f"{a:.4f} ({b:.4f})" for a, b in zip(*pair, strict=True)))
            for row, pair in enumerate(zip(ours, printed, strict=True), start=1)
        ]
        text += f"\n\nTable {numeral}, ours (printed):\n\n"
        text += markdown_table(("row", "y1", "y2", "y3", "y4"), beside)
    checks = [
        at_most("Table I: largest difference", apart[0].largest, 6e-4),
        near("Table II: relative difference", apart[1].relative, 0.047, 0.005),
        at_most("Table III: largest difference", apart[2].largest, 2e-3),
    ]
    return Section(4, "Tables I to III", text, checks, data={"gains": gains.tolist()})


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
    batch: SequenceBatch,
    outcomes: dict[str, BoundedEstimates],
    flipped: Mutant,
    wrong_rule: Mutant,
) -> Section:
    some = next(iter(outcomes.values()))
    text = _GUARANTEE.format(
        count=some.radius.shape[1], families=", ".join(FAMILIES), cycles=CYCLES
    )
    head = ("estimator", "sets", "outside", "largest", "mean tr P", "sum of half-widths")
    rows = []
    for name, one in outcomes.items():
        trace, ends = one.trace.mean(), one.half_widths[one.steps % G == 0]
        size = "" if np.isnan(trace) else f"{trace:.2f}"
        rows.append((*_counted(name, one), size, f"{ends.sum(-1).mean():.2f}"))
    text += "\n" + markdown_table(head, rows) + "\n\n" + _MUTANTS + "\n"
    planted = {"sign of Xi flipped": flipped, "winners by Q y^2": wrong_rule}
    text += markdown_table(
        ("mistake", "outside", "no set left", "of instants", "sequences touched", "of"),
        [
            (name, *map(str, (m.outside, m.contradicted, m.instants, m.sequences, m.of)))
            for name, m in planted.items()
        ],
    )
    checks = [*_held("", outcomes), *prior_checks(batch.states[:, 0])]
    checks += [above(f"{name}: violations", m.outside, 0) for name, m in planted.items()]
    data = {name: {"violations": int(one.violations.sum())} for name, one in outcomes.items()}
    data |= {name: m._asdict() for name, m in planted.items()}
    return Section(5, "The guarantee", text, checks, data=data)


def prior_checks(starts: np.ndarray) -> list[Check]:
    """First states (R, n), half of them on the edge of the ball, are held by the prior, tightly.

    A prior that is too small is not seen in the sets that follow, which are wide.
    """
    largest = float((starts * np.linalg.solve(PRIOR_SHAPE, starts.T).T).sum(axis=-1).max())
    checks = [at_most("prior: largest e' P^-1 e of a first state", largest, 1 + 1e-9)]
    if len(starts) > EDGE_SEQUENCE:
        checks.append(near("prior: a first state on its edge", largest, 1.0, 1e-9))
    return checks


def _counted(name: str, one: BoundedEstimates) -> tuple[str, ...]:
    """Name, sets, sets that miss the truth, largest e' P^+ e."""
    outside = int(one.violations.sum())
    return name, str(one.radius.size), str(outside), f"{one.radius.max():.9f}"


# --- sizes over time -----------------------------------------------------------------------------


def _traces(outcomes: dict[str, BoundedEstimates]) -> Section:
    by_cycle_ = {name: outcomes[name].trace[:, 0] for name in ("paper", "fast", "tight")}
    by_cycle_["fast-rate, last step"] = outcomes["fast-rate"].trace[G - 1 :: G, 0]
    widths = {
        name: one.half_widths[one.steps % G == 0][:, 0].sum(-1) for name, one in outcomes.items()
    }
    head = ("estimator", *(str(cycle + 1) for cycle in range(CYCLES)))
    of_traces, of_widths = (
        markdown_table(head, [(name, *(f"{v:.2f}" for v in row)) for name, row in values.items()])
        for values in (by_cycle_, widths)
    )
    text = (
        "tr P after each cycle on the paper's noise (of three steps; fast-rate: of one):\n\n"
        f"{of_traces}\n\nSum of the half-widths of the state at the end of each cycle:\n\n"
        + of_widths
    )
    ours = by_cycle_["paper"]
    checks = [
        near(f"tr P after cycle {k + 1}", value, expected, _RELATIVE * expected)
        for k, (value, expected) in enumerate(zip(ours, TRACES, strict=True))
    ]
    fast = float(np.mean(by_cycle_["fast"]))
    checks.append(near("fast: mean tr P", fast, FAST_TRACE, _RELATIVE * FAST_TRACE))
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
    rows = []
    for name, one in outcomes.items():
        end = one.trace[-1].max()
        rows.append((*_counted(name, one), "" if np.isnan(end) else f"{end:.1f}"))
    text += "\n\n"
    text += markdown_table(("estimator", "sets", "outside", "largest", "tr P, last, largest"), rows)
    return Section(7, "Long unstable runs", text, _held(", long runs", outcomes))


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
