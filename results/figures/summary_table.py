"""The figures of runs for people: the verdict and three lines, a table of the nodes, and more."""

from collections.abc import Sequence
from textwrap import wrap

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from concord.results.bus import bus_report
from concord.results.figures import timing_figures
from concord.results.figures.intervals import Interval
from concord.results.figures.smoothed_errors import shown_lags
from concord.results.figures.summary import Summary
from concord.results.innovations.figures import NisFigures
from concord.results.innovations.presentation import nis_columns
from concord.results.records import record_spread
from concord.scenarios.scenario import Scenario
from concord.scenarios.types.schedules import occupancy_of

# Beyond this ratio the error of the filter that hears everything is rounding.
_EXACT = 1e6
MOST_ROWS = 8
"""A larger network's table of nodes is shown where it is asked for."""
LEGEND = (
    "RMSE         error of the node in the network",
    "alone        its error without neighbours",
    "ANEES        squared error over its covariance: 1 is right, more overconfident",
    "NIS          the same of innovations, which are readings minus their predictions",
    "sent, heard  frames; missed: frames that were due and did not come",
    "rejected     frames that the node could not use",
    "centralised  one filter that hears every sensor",
)
_TRAFFIC = ("sent", "heard", "missed", "rejected")


_LINE, _INDENT = 80, 11


def opening(figures: Summary, scenario: Scenario, driver: str) -> list[str]:
    """Return the verdict, and below it error, honesty and bus, in lines of 80 characters."""
    return [
        line
        for said in _opening(figures, scenario, driver)
        for line in wrap(said, _LINE, subsequent_indent=" " * _INDENT, break_long_words=False)
    ]


def _opening(figures: Summary, scenario: Scenario, driver: str) -> list[str]:
    level, said = figures.verdict.level, _works(figures, scenario, driver)
    finding = figures.verdict.findings[0]
    lines = [f"{level:<6} {said if level == 'WORKS' else finding.said}"]
    if level != "WORKS" and finding.cure:
        lines.append(f"  cure     {finding.cure}")
    if (error := _error(figures)) is not None:
        lines.append(f"  error    {error}")
    of_honesty = [one for one in figures.verdict.findings if one.level == "WORKS"]
    if of_honesty:
        lines.append(f"  honesty  {of_honesty[0].in_words()}")
    lines.append(f"  bus      {_bus(figures, scenario)}")
    lines += [f"  also     {one.in_words()}" for one in figures.verdict.findings[1:]
              if one.level != "WORKS"]  # fmt: skip
    return lines + [f"  members  {one.in_words()}" for one in figures.outages]


def _works(figures: Summary, scenario: Scenario, driver: str) -> str:
    processes = "node processes" if driver in ("processes", "realtime") else "nodes"
    runs = "" if figures.runs == 1 else f"{figures.runs} runs of "
    missed = figures.value("shares_missed")
    rejected = sum(one["rejected"].value for one in figures.nodes)
    frames = (
        "no frame was missed or rejected"
        if not missed + rejected
        else f"{missed:,.0f} frames were missed and {rejected:,.0f} rejected"
    )
    return f"{scenario.nodes} {processes} took {runs}{figures.steps} steps; {frames}."


def _error(figures: Summary) -> str | None:
    found = figures.figures
    if np.isnan(found["rmse"].value):
        return None
    where = {
        "rmse": "in the network",
        "rmse_alone": "for a node alone",
        "rmse_centralised": "for one filter with all readings",
    }
    return ", ".join(
        f"{with_unit(found[name], figures.unit)} {words}"
        for name, words in where.items()
        if not np.isnan(found[name].value)
    )


def with_unit(interval: Interval, unit: str) -> str:
    """Return a figure with its unit; one without unit has none."""
    return f"{shown(interval)} {unit}".rstrip()


def _bus(figures: Summary, scenario: Scenario) -> str:
    part = occupancy_of(scenario.bus.schedule)
    who = "every node sends" if part == 1 else f"{_part(part)} of the nodes send"
    sent = figures.value("bytes_per_step")
    return f"{who} in a cycle: {sent:.0f} bytes a step on {scenario.bus.name}"


def _part(part: float) -> str:
    names = {0.25: "a quarter", 0.5: "half", 0.1: "a tenth"}
    return names.get(part, f"{100 * part:.3g} %")


def title_of(scenario: Scenario, driver: str) -> str:
    """Return the title of the table."""
    return (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, {driver}"
    )


def table(figures: Summary, title: str) -> Table:
    """The figures as a table: one row per node, then the network, then what frames it."""
    grid = _empty_table(title, (*_headings(figures), *_TRAFFIC))
    innovations = figures.innovations
    for i, node in enumerate(figures.nodes):
        own = None if innovations is None else innovations.nodes[i]
        traffic = (f"{node[name].value:.4g}" for name in _TRAFFIC)
        grid.add_row(str(i), *_cells(figures, node, own), *traffic)
    grid.add_section()
    whole = figures.figures
    own = None if innovations is None else innovations.network
    sent, missed = (f"{whole[name].value:.6g}" for name in ("shares_sent", "shares_missed"))
    grid.add_row("all", *_cells(figures, whole, own), sent, "", missed, "")
    central = {
        name.removesuffix("_centralised"): one
        for name, one in whole.items()
        if name.endswith("_centralised")
    }
    own = None if innovations is None else innovations.centralised
    grid.add_row("centralised", *_cells(figures, central, own))
    return grid


def _sets(figures: Summary) -> bool:
    return not np.isnan(figures.value("sets"))


def _without_truth(figures: Summary) -> bool:
    """Whether the innovations are all that is known."""
    return figures.innovations is not None and np.isnan(figures.value("rmse"))


def _headings(figures: Summary) -> tuple[str, ...]:
    """The columns between the node and its traffic."""
    unit = f"[{figures.unit}]"
    if _sets(figures):
        return f"RMSE {unit}", "out", "largest", "√tr P"
    if _without_truth(figures):
        return "NIS", "95 %", "readings"
    return f"RMSE {unit}", f"alone {unit}", "ANEES", *(["NIS"] if figures.innovations else [])


def _cells(figures: Summary, row: dict[str, Interval], own: NisFigures | None) -> tuple[str, ...]:
    """The cells below `_headings`; a figure that the row has not is an empty cell."""
    if _sets(figures):
        outside = row.get("sets_outside")
        count = "-" if outside is None or np.isnan(outside.value) else f"{outside.value:.4g}"
        return (_cell(row, "rmse"), count, _cell(row, "set_largest"), _cell(row, "set_half_width"))
    if own is not None and _without_truth(figures):
        return nis_columns(own)
    cells = tuple(_cell(row, name) for name in ("rmse", "rmse_alone", "anees"))
    return cells if own is None else (*cells, nis_columns(own)[0])


def _cell(row: dict[str, Interval], name: str) -> str:
    return "" if name not in row else short(row[name].value)


def _empty_table(title: str, headings: Sequence[str]) -> Table:
    """A table that cuts no name: headings break at spaces, and the node's name does not."""
    # A name such as a[b].py:CAR is text, and no markup of rich.
    grid = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    grid.add_column("node", justify="right", no_wrap=True, min_width=len("centralised"))
    for heading in headings:
        longest = max(map(len, heading.split()), default=0)
        grid.add_column(Text(heading), justify="right", min_width=longest)
    return grid


def lines(figures: Summary) -> list[str]:
    """Return the lines below the table: figures that have no column."""
    unit, found = figures.unit, figures.figures
    text = [_beside(figures)] if not np.isnan(figures.value("to_centralised")) else []
    scored = f"scored from step {figures.first_step} of {figures.steps}"
    several = (
        f"{figures.runs} runs from run {figures.first_run} on, ± is half of the 95 % interval; "
    )
    runs = "" if figures.runs == 1 else several
    text.append(f"{runs}disagreement {with_unit(found['disagreement'], unit)}; {scored}")
    if _sets(figures):
        text.append(
            f"sets: {found['sets_outside'].value:.4g} of {found['sets'].value:.4g} do not hold the "
            f"truth; e' P^-1 e is at most {found['set_largest'].value:.12g}, and 1 is the edge"
        )
    if any(suspect := figures.details.get("suspect", [])):
        doubted = ", ".join(f"{count:.3g} of node {i}" for i, count in enumerate(suspect) if count)
        text.append(
            f"warning: steps in which records of a node do not fit its belief: {doubted}; one in "
            "1,000 is chance, and more say that the model was off for a while (docs/labelled.md)"
        )
    if (smoothed := figures.details.get("smoothed")) is not None:
        chosen = [smoothed[lag] for lag in shown_lags(len(smoothed))]
        ratios = ", ".join(f"{shown(one.to_centralised)} at {one.lag}" for one in chosen)
        text.append(f"smoothed, x the centralised smoother of that lag in steps: {ratios}")
    if (tracking := figures.details.get("tracking")) is not None:
        text += tracking.lines()
    if figures.noticed:
        counts = ", ".join(f"{name} {count:.4g}" for name, count in figures.noticed.items())
        text.append(f"nodes noticed: {counts}")
    if not np.isnan(central := figures.value("rmse_near_centralised")):
        near = [one["rmse_near"].value for one in figures.nodes]
        text.append(
            f"near a reading: nodes {', '.join(map(short, near))} {unit}, centralised "
            f"{short(central)}, worst node {max(near) / central:.2f} x"
        )
    return [*text, *([f"warning: {figures.warning}"] if figures.warning else [])]


def _beside(figures: Summary) -> str:
    """The network and its worst node beside the filter that hears everything."""
    found = figures.figures
    if found["to_centralised"].value > _EXACT:
        return "the filter that hears everything knows the state exactly"
    return (
        f"network {shown(found['to_centralised'])} x centralised, worst node "
        f"{shown(found['worst_node_to_centralised'])} x"
    )


def details(figures: Summary) -> list[str]:
    """Return the lines that `--verbose` adds: bus, records, timing, and the run's own pace."""
    found = figures.details
    text = [one.in_words() for one in figures.verdict.findings[1:]]
    if "bus" in found:
        text += bus_report.lines(found["bus"])
    if "spread" in found:
        text += record_spread.lines(found["spread"])
    if "timing" in found:
        text += timing_figures.lines(found["timing"])
    if "ready_s" in found:
        text.append(f"ready after {found['ready_s']:.2f} s")
    if "steps_per_second" in found:
        text.append(f"{found['steps_per_second']:.1f} steps per second")
    if found.get("repeated_messages"):
        text.append(f"{found['repeated_messages']} messages were repeated between processes")
    if "seconds" in found:
        text.append(
            f"{found['seconds']:.2f} s, {found['node_updates_per_second']:,.0f} node updates per "
            f"second, peak memory {found['peak_memory_mb']:.0f} MB"
        )
    return text


def short(value: float) -> str:
    """Return four digits, or a dash."""
    return "-" if np.isnan(value) else f"{value:.4g}"


def shown(interval: Interval) -> str:
    """A figure and the spread of its interval."""
    if np.isnan(interval.value):
        return "-"
    return f"{interval.value:.3g} {interval.spread('± ')}".rstrip()
