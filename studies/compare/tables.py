"""A comparison as tables: for a terminal of 80 columns, a page, Markdown and LaTeX."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from concord.results.report_page import Code, Grid, Heading, PagePart, Paragraph, as_latex
from concord.studies.compare.results import CaseFigures, ComparisonFigures, RuleFigures

COLUMNS = ("error", "95 %", "ANEES", "±", "bytes", "wire us", "node", "")
MEANING = (
    "error: root mean square error over that of one filter that hears everything, with the 95 % "
    "interval of paired runs (log scale). ANEES: normalised squared error per state; 1 is "
    "consistent, above 1 is overconfident. bytes, wire us: on the bus in a "
    "step. node: processor time of a step at the busiest node, over that of the cheapest rule. "
    "Last: CHECK for overconfident rules, FAILED for rules of which a run failed."
)
_OVERVIEWS: dict[str, Callable[[RuleFigures], float]] = {
    "Error over the centralised filter": lambda one: one.to_centralised.value,
    "ANEES (above 1 is overconfident)": lambda one: one.anees.value,
    "Bytes in a step": lambda one: one.bytes_per_step.value,
    "Microseconds on the wire in a step": lambda one: one.bus_time_us.value,
    "Processor time of a node's step over that of the cheapest rule": lambda one: one.node_ratio,
}


def print_comparison(figures: ComparisonFigures, console: Console) -> None:
    """Print a table for each case, and why rules could not run."""
    for case in figures.cases:
        ran = [one for one in case.rules if not one.reason]
        runs = "1 run" if case.runs == 1 else f"{case.runs} runs"
        console.print(f"{case.case}: {case.purpose}; {runs}")
        if ran:
            grid = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
            grid.add_column("rule", overflow="fold", min_width=12, max_width=24)
            for heading in COLUMNS:
                grid.add_column(heading, justify="right", no_wrap=True)
            for one in ran:
                grid.add_row(one.rule, *cells_of_rule(one))
            console.print(grid)
        for reason, rules in _reasons(case).items():
            # The cure stands in --json and in the report.
            console.print(
                f"  not {_named(rules, case)}: {reason.partition(';')[0]}",
            )
        console.print()
    console.print(MEANING)


def cells_of_rule(one: RuleFigures) -> tuple[str, ...]:
    """Return the texts of `COLUMNS` of a rule."""
    error, anees = one.to_centralised, one.anees
    between = "-" if np.isnan(error.low) else f"{_short(error.low)}..{_short(error.high)}"
    half = "-" if np.isnan(anees.low) else f"{(anees.high - anees.low) / 2:.2g}"
    return (
        _short(error.value), between, _short(anees.value), half,
        _short(one.bytes_per_step.value), _short(one.bus_time_us.value),
        _short(one.node_ratio), "" if one.level == "WORKS" else one.level,
    )  # fmt: skip


def overviews(figures: ComparisonFigures) -> list[PagePart]:
    """Return one table for each figure, a row for each rule and a column for each case that ran."""
    cases = [case for case in figures.cases if any(not one.reason for one in case.rules)]
    parts: list[PagePart] = []
    for title, figure in _OVERVIEWS.items():
        rows = []
        for rule in rules_of(figures):
            found = [next(one for one in case.rules if one.rule == rule) for case in cases]
            rows.append([rule, *(_short(figure(one)) for one in found)])
        parts += [Heading(title), Grid(["rule", *(case.case for case in cases)], rows, 1)]
    return parts


def rules_of(figures: ComparisonFigures) -> list[str]:
    """Return all rules in order of their median error over the cases that they ran on."""
    rules = [one.rule for one in figures.cases[0].rules]
    places: dict[str, list[float]] = {rule: [] for rule in rules}
    for case in figures.cases:
        for one in case.rules:
            if not np.isnan(one.to_centralised.value):
                places[one.rule].append(np.log(one.to_centralised.value))
    return sorted(rules, key=lambda rule: (not places[rule], _middle(places[rule])))


def page(figures: ComparisonFigures) -> list[PagePart]:
    """Return the parts of the report: overviews, each case in full, provenance."""
    title = f"{len(rules_of(figures))} fusion rules on {len(figures.cases)} cases"
    parts: list[PagePart] = [Heading(title, 1), Paragraph(MEANING), *overviews(figures)]
    for case in figures.cases:
        parts += [Heading(case.case), Paragraph(f"{case.purpose}; {case.runs} runs.")]
        parts.append(
            Code(" ".join(f"--{k.replace('_', '-')} {v}" for k, v in case.options.items()))
        )
        ran = [one for one in case.rules if not one.reason]
        if ran:
            rows = [[one.rule, *cells_of_rule(one)] for one in ran]
            parts.append(Grid(["rule", *COLUMNS], rows, 1))
        parts += [
            Paragraph(f"Not {_named(rules, case)}: {reason}.")
            for reason, rules in _reasons(case).items()
        ]
    said = ", ".join(f"{name} {version}" for name, version in figures.versions.items())
    return [*parts, Paragraph(f"Computed by {said}, commit {figures.commit}.")]


def latex(figures: ComparisonFigures) -> str:
    """Return a LaTeX table with every case and rule that ran."""
    rows = [
        [case.case, one.rule, *cells_of_rule(one)]
        for case in figures.cases
        for one in case.rules
        if not one.reason
    ]
    return as_latex([Grid(["case", "rule", *COLUMNS], rows, 2)])


def as_json(figures: ComparisonFigures) -> bytes:
    """Return the figures as one JSON object; what is unknown is null."""
    return msgspec.json.encode(figures)


def _reasons(case: CaseFigures) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for one in case.rules:
        if one.reason:
            # Rules of one kind differ in the name that begins their sentence.
            reason = one.reason.removeprefix(f"rule {one.rule} ").removeprefix(f"rule {one.rule}: ")
            found.setdefault(reason, []).append(one.rule)
    return found


def _named(rules: Sequence[str], case: CaseFigures) -> str:
    return "any rule" if len(rules) == len(case.rules) else ", ".join(rules)


def _middle(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _short(value: float) -> str:
    """Return three digits, and all digits before the point."""
    if np.isnan(value):
        return "-"
    if value >= 1e6:
        return f"{value:.2g}"
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
