"""`concord collect`: arrays, capture and figures of a run from what it recorded.

`concord run` ends with it. A run that was interrupted, or that broke off, leaves its recording at
once; this makes the rest of it when there is time.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
import tyro

from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.figures.summary import Figures, summarise
from concord.results.figures.summary_table import details, lines, opening, table
from concord.results.figures.timing_figures import TimingFigures, figures_of
from concord.results.folder import Description, read_description
from concord.results.innovations.of_run import channel_table, run_innovations
from concord.results.records.netcdf_file import RECORDING
from concord.results.records.trace import Trace
from concord.results.run_results import (
    NO_MORE,
    Captures,
    as_it_ran,
    check_captures,
    completed,
    write_results,
)
from concord.results.run_verdict import LEGEND
from concord.results.smoothing import (
    SmoothingFigures,
    check_smoothing,
    smoothed_of,
    smoothing_figures,
    smoothing_line,
    write_smoothed,
)
from concord.runtime.drivers import RunPace
from concord.runtime.recording import read_recording
from concord.runtime.recording_repair import finish_recording
from concord.studies.alternative import labelled_beside

CaptureCycles = Literal["used", "all"]
"""Cycles of the bus in a capture."""


class FiguresForm(NamedTuple):
    """How figures are shown: as one JSON object, or as a table with or without details."""

    as_json: bool
    verbose: bool


@dataclass(frozen=True, kw_only=True)
class ResultOptions:
    """How to show the figures of a run, and what it leaves beside its arrays."""

    json: bool = False
    """Print one JSON object instead of a table."""
    verbose: bool = False
    """Also print the figures of bus, records and timing."""
    capture: CaptureCycles = "used"
    """Cycles in bus.pcap: used (those with rounds), or all, with null frames between the steps."""
    capture_nodes: tuple[int, ...] = ()
    """Nodes that get a capture of what they received, bus_node_<N>.pcap."""
    smooth: bool = False
    """Also smooth the whole run with the readings of all sensors, into smoothed.nc."""


@dataclass(frozen=True, kw_only=True)
class CollectOptions(ResultOptions):
    """Which run."""

    folder: tyro.conf.Positional[Path]
    """Folder of a run."""


def collect(options: Annotated[CollectOptions, tyro.conf.arg(name="")]) -> None:
    """Finish the recording of a run that was interrupted; make its arrays, capture and figures."""
    with user_errors():
        description = read_description(options.folder)
        captures = Captures(options.capture == "all", options.capture_nodes)
        check_captures(description.setup, captures)
        if options.smooth:
            check_smoothing(description.setup)
        finish_recording(options.folder / RECORDING)
        trace = completed(options.folder, description)
    finish(
        options.folder,
        description,
        trace,
        RunPace(None, None),
        FiguresForm(options.json, options.verbose),
        captures,
        options.smooth,
    )


def finish(
    folder: Path,
    description: Description,
    trace: Trace,
    pace: RunPace,
    shown: FiguresForm,
    captures: Captures = NO_MORE,
    smooth: bool = False,
) -> None:
    """Write run.nc and the captures, with `smooth` smoothed.nc, and print the figures."""
    description = as_it_ran(description, trace)
    innovations = run_innovations(description.setup, trace)
    write_results(folder, description, trace, captures, innovations)
    found = summarise(description.setup, trace, innovations)
    figures = msgspec.structs.replace(
        found,
        timing=_timing(folder, description, trace),
        steps_per_second=pace.steps_per_second,
        ready_s=pace.ready_s,
        labelled=labelled_beside(description.setup, trace, found.first_step),
        smoothing=_smoothing(folder, description, trace, found.first_step) if smooth else None,
    )
    _show(figures, description, shown)


def _smoothing(
    folder: Path, description: Description, trace: Trace, first: int
) -> SmoothingFigures:
    found = smoothed_of(description.setup, trace)
    write_smoothed(folder, description, found)
    return smoothing_figures(description.setup, trace, found, first)


def _timing(folder: Path, description: Description, trace: Trace) -> TimingFigures | None:
    if description.tempo is None:
        return None
    messages = read_recording(folder / RECORDING)
    return figures_of(description.tempo, messages, trace.counters, trace.estimate_age_s)


def _show(figures: Figures, description: Description, shown: FiguresForm) -> None:
    if shown.as_json:
        sys.stdout.write(msgspec.json.encode(figures).decode() + "\n")
        return
    console = plain_console()
    scenario = description.setup.scenario
    title = (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, {description.driver}"
    )
    for line in opening(figures):
        console.print(line, style="bold")
    console.print(table(figures, title))
    if figures.smoothing is not None:
        console.print(smoothing_line(figures.smoothing, figures.unit))
    innovations = figures.innovations
    if innovations is not None and (shown.verbose or np.isnan(figures.rmse)):
        console.print(channel_table(innovations))
    for line in (*lines(figures), *(details(figures) if shown.verbose else ())):
        console.print(line)
    if figures.containment is None:
        for line in LEGEND:
            console.print(line, style="dim")
    if figures.verdict is not None:
        console.print(f"verdict: {figures.verdict}", style="bold")
