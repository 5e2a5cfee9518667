"""`concord run`: one scenario, one driver, one folder of results, one table of figures."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tyro
from rich.console import Console

from bus.pcap import write_pcap
from experiments.bus_report import capture
from experiments.drivers import DRIVERS, Pace
from experiments.launcher import NetworkFailed
from experiments.options import ScenarioOptions
from experiments.progress import progress
from experiments.results import (
    CAPTURE,
    RECORDING,
    Description,
    describe,
    make_folder,
    new_name,
    write_arrays,
    write_description,
)
from experiments.summary import Figures, lines, summarise, table
from experiments.trace import Trace, read_trace
from experiments.user_errors import user_errors
from nodes.recording import read_recording
from scenarios.setup import prepare


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How and where to run."""

    driver: Literal["in-process", "processes"] = "in-process"
    """in-process: everything in one process; processes: one per node, over zenoh, in lockstep."""
    out: Path | None = None
    """Folder for the results; runs/<name> when left out. It must not exist."""
    port: int | None = None
    """First of consecutive loopback ports for --driver processes; free ones when left out."""
    json: bool = False
    """Print one JSON object instead of a table."""


def run(
    scenario: Annotated[ScenarioOptions, tyro.conf.arg(name="")],
    options: Annotated[RunOptions, tyro.conf.arg(name="")],
) -> None:
    """Run a scenario once and print how well its nodes did."""
    with user_errors():
        setup = prepare(scenario.resolve())
        name = new_name(setup.scenario.name)
        description = describe(name, options.driver, setup)
        # Described first: a folder is never without its description.
        folder = make_folder(options.out, name)
        write_description(folder, description)
    sys.stderr.write(f"seed {setup.scenario.seed}; results in {folder}\n")
    pace = Pace(None, None)
    try:
        with progress(f"{setup.scenario.name}", setup.scenario.steps) as on_step, user_errors():
            driver = DRIVERS[options.driver]
            pace = driver(setup, name, folder / RECORDING, options.port, on_step)
    except NetworkFailed as error:
        sys.stderr.write(f"concord: {error}; what was done until then is in {folder}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        # Who is in a hurry gets the arrays; the filters to compare with would take their time.
        _keep(folder, description)
        raise
    trace = _keep(folder, description)
    assert trace is not None, "a run that ended well has at least one step"
    figures = msgspec.structs.replace(
        summarise(description.setup, trace),
        steps_per_second=pace.steps_per_second,
        ready_s=pace.ready_s,
    )
    _show(figures, description, options.json)


def _keep(folder: Path, description: Description) -> Trace | None:
    """Turn the recording into arrays and a capture; None when no step was completed."""
    trace = _trace(folder, description)
    if trace is None:
        return None
    write_arrays(folder, description, trace)
    frames = capture(description.setup, trace, read_recording(folder / RECORDING))
    if frames is not None:
        write_pcap(folder / CAPTURE, frames)
    return trace


def _trace(folder: Path, description: Description) -> Trace | None:
    recording = folder / RECORDING
    if not recording.exists():
        return None
    trace = read_trace(description.setup, read_recording(recording))
    return trace if trace.steps else None


def _show(figures: Figures, description: Description, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(figures).decode() + "\n")
        return
    console = Console()
    scenario = description.setup.scenario
    title = (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.graph}, {scenario.rule}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, {description.driver}"
    )
    console.print(table(figures, title))
    for line in lines(figures):
        console.print(line, highlight=False)
