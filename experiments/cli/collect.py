"""`concord collect`: arrays, capture and figures of a run from what it recorded.

`concord run` ends with it. A run that was interrupted, or that broke off, leaves its recording at
once; this makes the rest of it when there is time.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.console import Console

from bus.recordings.pcap import write_pcap
from experiments.results.bus_report import capture
from experiments.results.folder import (
    CAPTURE,
    RECORDING,
    Description,
    read_description,
    write_arrays,
)
from experiments.results.summary import Figures, lines, summarise, table
from experiments.results.timing_figures import TimingFigures, figures_of
from experiments.results.trace import Trace, read_trace
from experiments.user_errors import user_errors
from runtime.disk import writing
from runtime.drivers import RunPace
from runtime.recording import read_recording


@dataclass(frozen=True)
class CollectOptions:
    """Which run."""

    folder: tyro.conf.Positional[Path]
    """Folder of a run."""
    json: bool = False
    """Print one JSON object instead of a table."""


def collect(options: Annotated[CollectOptions, tyro.conf.arg(name="")]) -> None:
    """Make arrays, bus capture and figures of a run that was interrupted."""
    with user_errors():
        description = read_description(options.folder)
        trace = completed(options.folder, description)
    finish(options.folder, description, trace, RunPace(None, None), options.json)


def finish(
    folder: Path, description: Description, trace: Trace, pace: RunPace, as_json: bool
) -> None:
    """Write run.nc and bus.pcap, print the figures."""
    write_arrays(folder, description, trace)
    frames = capture(description.setup, trace, read_recording(folder / RECORDING))
    if frames is not None:
        with writing(folder / CAPTURE):
            write_pcap(folder / CAPTURE, frames)
    figures = msgspec.structs.replace(
        summarise(description.setup, trace),
        timing=_timing(folder, description, trace),
        steps_per_second=pace.steps_per_second,
        ready_s=pace.ready_s,
    )
    _show(figures, description, as_json)


def _timing(folder: Path, description: Description, trace: Trace) -> TimingFigures | None:
    if description.tempo is None:
        return None
    return figures_of(description.tempo, read_recording(folder / RECORDING), trace.counters)


def completed(folder: Path, description: Description) -> Trace:
    """Return the trace of the steps that all nodes completed.

    Raises:
        ValueError: there are none.
    """
    recording = folder / RECORDING
    if not recording.exists():
        raise ValueError(f"{recording}: there is none; the run ended before it began to record")
    trace = read_trace(description.setup, read_recording(recording))
    if not trace.steps:
        raise ValueError(f"{recording}: the run ended before all nodes completed a step")
    return trace


def _show(figures: Figures, description: Description, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(figures).decode() + "\n")
        return
    console = Console()
    scenario = description.setup.scenario
    title = (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, {description.driver}"
    )
    console.print(table(figures, title))
    for line in lines(figures):
        console.print(line, highlight=False)
