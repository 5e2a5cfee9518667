"""`concord collect`: arrays, capture and figures of a run from what it recorded.

`concord run` ends with it. A run that was interrupted, or that broke off, leaves its recording at
once; this makes the rest of it when there is time.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import tyro

from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import FAILED, user_errors
from concord.results.figures.summary import Summary, heard_by_all, summarise
from concord.results.figures.summary_table import (
    LEGEND,
    MOST_ROWS,
    details,
    lines,
    opening,
    table,
    title_of,
)
from concord.results.figures.timing_figures import TimingFigures, figures_of
from concord.results.folder import (
    WITHOUT_CODE,
    Description,
    read_shown,
    recording_of,
    write_verdict,
)
from concord.results.innovations.presentation import channel_table
from concord.results.records.netcdf_file import ARRAYS, RECORDING
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import Trace
from concord.results.run_results import (
    NO_MORE,
    Captures,
    as_it_ran,
    check_captures,
    completed,
    write_results,
)
from concord.results.smoothing import (
    SmoothingFigures,
    check_smoothing,
    smoothed_of,
    smoothing_figures,
    smoothing_line,
    write_smoothed,
)
from concord.results.verdict.findings import VerdictOnRuns
from concord.runtime.drivers import RunPace
from concord.runtime.recording import read_recording
from concord.runtime.recording_repair import finish_recording
from concord.scenarios.catalogue import is_received
from concord.scenarios.user.trust import trust
from concord.studies.alternative import BetterRule, labelled_beside
from concord.studies.progress import progress

CaptureCycles = Literal["used", "all"]
"""Cycles of the bus in a capture."""


_MB_BYTES = 1_000_000
# To read a recording of this length takes about three seconds.
_LONG_MB = 64


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
    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def collect(options: Annotated[CollectOptions, tyro.conf.arg(name="")]) -> None:
    """Finish the recording of a run that was interrupted; make its arrays, capture and figures."""
    with user_errors():
        trust(options.trust)
        description = read_shown(options.folder)
        captures = Captures(options.capture == "all", options.capture_nodes)
        check_captures(description.setup, captures)
        if options.smooth:
            if is_received(description.setup.scenario):
                raise ValueError(
                    "--smooth: needs the code of the plant; if it may run here, add "
                    f"--trust {options.folder}"
                )
            check_smoothing(description.setup)
        finish_recording(options.folder / RECORDING)
        trace = trace_with_progress(options.folder, description, options.json)
    figures = finish(
        options.folder,
        description,
        trace,
        RunPace(None, None),
        FiguresForm(options.json, options.verbose),
        captures,
        options.smooth,
    )
    end_by(figures.verdict)


def trace_with_progress(folder: Path, description: Description, as_json: bool) -> Trace:
    """Return what a recording says; one that takes some time to read tells how far it is.

    Raises:
        ValueError: no step is complete.
    """
    total = recording_of(folder).stat().st_size // _MB_BYTES
    if total < _LONG_MB:
        return completed(folder, description)
    with progress("MB of the recording", total, as_json=as_json) as on_mb:
        trace = completed(folder, description, lambda read_bytes: on_mb(read_bytes // _MB_BYTES))
        on_mb(total)
    return trace


def end_by(verdict: VerdictOnRuns) -> None:
    """End with exit code 1 where the verdict is FAILED."""
    if verdict.has_failed:
        sys.exit(FAILED)


def finish(
    folder: Path,
    description: Description,
    trace: Trace,
    pace: RunPace,
    shown: FiguresForm,
    captures: Captures = NO_MORE,
    smooth: bool = False,
) -> Summary:
    """Write run.nc and the captures, with `smooth` smoothed.nc, and print the figures."""
    description = as_it_ran(description, trace)
    runs = runs_of_trace(description.setup, trace)
    heard = heard_by_all(runs)
    without_code = is_received(description.setup.scenario)
    # The arrays and the verdict of a run's owner hold more than can be known without its code.
    if not (without_code and (folder / ARRAYS).is_file()):
        write_results(folder, description, trace, runs, captures, heard)
    if without_code:
        sys.stderr.write(WITHOUT_CODE.format(folder=folder))
    found = summarise(runs, heard=heard)
    figures = found.with_details(
        timing=_timing(folder, description, trace),
        **pace._asdict(),
        smoothing=_smoothing(folder, description, trace, found.first_step) if smooth else None,
    )
    if trace.damaged_bytes:
        figures = figures.with_details(damaged_bytes=trace.damaged_bytes)
    show(
        figures,
        description,
        folder,
        shown,
        None if without_code else labelled_beside(runs, figures),
    )
    return figures


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


def show(
    figures: Summary,
    description: Description,
    folder: Path,
    shown: FiguresForm,
    better: BetterRule | None = None,
) -> None:
    """Keep the verdict in run.json; print the figures of runs, and what comes next."""
    if description.verdict is None or not is_received(description.setup.scenario):
        write_verdict(folder, figures.verdict)
    if shown.as_json:
        told = figures if better is None else figures.with_details(labelled=better._asdict())
        sys.stdout.write(told.as_json().decode() + "\n")
        return
    console, scenario = plain_console(), description.setup.scenario
    first, *others = opening(figures, scenario, description.driver)
    console.print(first, style="bold")
    for line in others:
        console.print(line)
    if shown.verbose or len(figures.nodes) <= MOST_ROWS:
        console.print(table(figures, title_of(scenario, description.driver)))
    innovations = figures.innovations
    if innovations is not None and (shown.verbose or np.isnan(figures.value("rmse"))):
        console.print(channel_table(innovations))
    smoothing = figures.details.get("smoothing")
    more = [] if smoothing is None else [smoothing_line(smoothing, figures.unit)]
    if damaged_bytes := figures.details.get("damaged_bytes"):
        more.append(
            f"  damage   {damaged_bytes} bytes in the middle of {RECORDING} are no messages and "
            "were skipped; what they held is empty in run.nc"
        )
    for line in (*more, *lines(figures), *(details(figures) if shown.verbose else ())):
        console.print(line)
    if shown.verbose:
        for line in LEGEND:
            console.print(line, style="dim")
    for line in (f"Files: {folder}", *_next(figures, folder, better, shown.verbose)):
        console.print(line, soft_wrap=True)


def _next(
    figures: Summary, folder: Path, better: BetterRule | None, is_verbose: bool
) -> Iterator[str]:
    """Yield what a reader may want to run next."""
    see = f"concord replay {folder}" if figures.runs == 1 else f"concord plot {folder}"
    yield f"Next:  {see}"
    if better is not None:
        yield f"       {better.command}"
        yield f"         that is {better.in_words()}"
    if not is_verbose and len(figures.nodes) > MOST_ROWS:
        yield "       --verbose shows each node"
