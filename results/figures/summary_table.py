"""The figures of one run for people: a table, and lines above and below it."""

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.table import Table

from concord.results.bus import bus_report
from concord.results.figures import timing_figures
from concord.results.figures.containment import Containment
from concord.results.figures.intervals import Interval
from concord.results.figures.smoothed_errors import shown_lags
from concord.results.figures.summary import Figures, LabelledFigures
from concord.results.innovations.figures import NisFigures
from concord.results.innovations.of_run import nis_columns
from concord.results.records import record_spread
from concord.results.run_verdict import verdict, worst_in_words


def table(figures: Figures, title: str) -> Table:
    """The figures as a table: one row per node, then the network, then what frames it."""
    grid = _empty_table(title, (*_headings(figures), "sent", "heard", "missed", "rejected"))
    innovations = figures.innovations
    for i, node in enumerate(figures.nodes):
        traffic = (node.sent, node.heard, node.missed, node.rejected)
        own = None if innovations is None else innovations.nodes[i]
        held = node.containment
        cells = _cells(figures, (node.rmse, node.rmse_local_only, node.anees), held, own)
        grid.add_row(str(i), *cells, *map(str, traffic))
    grid.add_section()
    whole = figures.rmse, figures.rmse_local_only, figures.anees
    own = None if innovations is None else innovations.network
    cells = _cells(figures, whole, figures.containment, own)
    grid.add_row("all", *cells, str(figures.shares_sent), "", str(figures.shares_missed), "")
    central = figures.rmse_centralised, None, figures.anees_centralised
    own = None if innovations is None else innovations.centralised
    grid.add_row("centralised", *_cells(figures, central, figures.containment_centralised, own))
    return grid


def _headings(figures: Figures) -> tuple[str, ...]:
    """The columns between the node and its traffic."""
    # Rich would take [m] for a style.
    unit = f"[{figures.unit}]"
    if figures.containment is not None:
        return f"RMSE {unit}", "out", "largest", "√tr P"
    if _without_truth(figures):
        return "NIS", "95 %", "readings"
    return f"RMSE {unit}", f"alone {unit}", "ANEES", *(["NIS"] if figures.innovations else [])


def _without_truth(figures: Figures) -> bool:
    """Whether the innovations are all that is known."""
    return figures.innovations is not None and np.isnan(figures.rmse)


def _cells(
    figures: Figures,
    errors: tuple[float, float | None, float],
    contained: Containment | None,
    own: NisFigures | None,
) -> tuple[str, ...]:
    """The cells below `_headings`: errors are RMSE, RMSE alone (None for no cell) and ANEES."""
    found, alone, anees_ = errors
    if contained is None and figures.containment is not None:
        return _short(found), "-", "-", "-"
    if contained is not None:
        sizes = map(_short, (contained.largest, contained.half_width))
        return _short(found), str(contained.violations), *sizes
    if own is not None and _without_truth(figures):
        return nis_columns(own)
    shown = _short(found), "" if alone is None else _short(alone), _short(anees_)
    return shown if own is None else (*shown, nis_columns(own)[0])


def _empty_table(title: str, headings: Sequence[str]) -> Table:
    """A table that cuts no name: headings break at spaces, and the node's name does not."""
    grid = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0)
    grid.add_column("node", justify="right", no_wrap=True, min_width=len("centralised"))
    for heading in headings:
        longest = max(map(len, heading.split()), default=0)
        grid.add_column(heading, justify="right", min_width=longest)
    return grid


def opening(figures: Figures) -> list[str]:
    """Return the lines above the table: the verdict, or what sets hold."""
    if figures.containment is None:
        anees_ = Interval(figures.anees, *(figures.anees_interval or (np.nan, np.nan)))
        compared = figures.rmse, figures.rmse_centralised, figures.rmse_local_only
        said = [verdict(*compared, anees_)]
        if figures.labelled is not None and not np.isnan(figures.rmse_centralised):
            wire_bytes = None if figures.bus is None else figures.bus.wire_bytes_per_step
            said.append(labelled_in_words(figures.labelled, figures.rmse_centralised, wire_bytes))
        return said
    held = figures.containment
    return [f"sets: {held.violations} of {held.sets} do not hold the truth"]


def labelled_in_words(beside: LabelledFigures, centralised: float, wire_bytes: float | None) -> str:
    """The sentence under the verdict on a run whose frames have so many bytes in a step."""
    would = f"labelled measurements would give {beside.rmse / centralised:.3g} x"
    if wire_bytes is None or beside.wire_bytes_per_step is None:
        return f"{would}: {beside.options}"
    return (
        f"on the bus: {wire_bytes:.0f} bytes a step; {would} at "
        f"{beside.wire_bytes_per_step:.0f} bytes: {beside.options}"
    )


def lines(figures: Figures) -> list[str]:
    """Return the lines below the table: figures that have no column."""
    unit = figures.unit
    text = [
        f"{worst_in_words(figures.worst_node_to_centralised)}"
        f"disagreement {_short(figures.disagreement)} {unit}; "
        f"scored from step {figures.first_step} of {figures.steps}"
    ]
    if figures.containment is not None:
        held = figures.containment
        text.append(
            f"sets: e' P^-1 e is at most {held.largest:.12g}, and 1 is the edge; half-width "
            f"√tr P in the mean {_short(held.half_width)}; nodes alone: RMSE "
            f"{_short(figures.rmse_local_only)} {unit}"
        )
    if figures.suspect is not None and any(figures.suspect):
        doubted = ", ".join(f"{i} in {count}" for i, count in enumerate(figures.suspect) if count)
        text.append(
            f"warning: beliefs do not fit the records of these nodes, in so many steps: {doubted}"
        )
    if figures.smoothed is not None:
        chosen = [figures.smoothed[lag] for lag in shown_lags(len(figures.smoothed))]
        ratios = ", ".join(
            f"{_short(one.rmse / one.rmse_centralised)} at {one.lag}" for one in chosen
        )
        text.append(f"smoothed, x the centralised smoother of that lag in steps: {ratios}")
    if figures.tracking is not None:
        text += figures.tracking.lines()
    if figures.noticed:
        counts = ", ".join(f"{name} {count}" for name, count in figures.noticed.items())
        text.append(f"nodes noticed: {counts}")
    if figures.near_s is not None:
        central = figures.rmse_near_centralised
        text.append(
            f"within {figures.near_s:g} s after a reading: nodes "
            f"{', '.join(map(_short, figures.rmse_near))} {unit}, centralised {_short(central)}, "
            f"worst node {max(figures.rmse_near) / central:.2f} x"
        )
    return text


def details(figures: Figures) -> list[str]:
    """Return the lines that `--verbose` adds: bus, records, timing, and the run's own pace."""
    text: list[str] = []
    if figures.bus is not None:
        text += bus_report.lines(figures.bus)
    if figures.spread is not None:
        text += record_spread.lines(figures.spread)
    if figures.timing is not None:
        text += timing_figures.lines(figures.timing)
    if figures.ready_s is not None:
        text.append(f"ready after {figures.ready_s:.2f} s")
    if figures.steps_per_second is not None:
        text.append(f"{figures.steps_per_second:.1f} steps per second")
    return text


def _short(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.4g}"
