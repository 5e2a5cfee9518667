"""Small runs for the tests of experiments/."""

from pathlib import Path

from concord.nodes.tempo import Tempo
from concord.results.figures.summary import Summary, heard_by_all, summarise
from concord.results.folder import describe, write_description, write_whole
from concord.results.records.netcdf_file import DESCRIPTION
from concord.results.records.runs import runs_of_trace
from concord.results.records.runs_file import runs_arrays
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_this_process
from concord.runtime.recording import read_recording, recorded_origin
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.setup import Setup
from concord.studies.audit.report import audit


def scenario(name: str = "oscillator", **changes) -> Scenario:
    """A scenario with its own defaults but for these changes."""
    return definition_named(name).defaults.with_(**changes)


def small(name: str = "oscillator", **changes) -> Setup:
    """Four nodes, a few steps."""
    return prepare(scenario(name, **{"nodes": 4, "steps": 12, **changes}))


def summary_of(setup: Setup, trace: Trace) -> Summary:
    """The figures of one run."""
    return summarise(runs_of_trace(setup, trace))


def write_arrays(folder: Path, setup: Setup, trace: Trace, tempo: Tempo | None = None) -> None:
    """Write run.nc of one run of processes, in real time with a tempo."""
    runs = runs_of_trace(setup, trace)
    arrays = runs_arrays(runs, heard=heard_by_all(runs))
    driver = "processes" if tempo is None else "realtime"
    recording = folder / "run.mcap"
    told = recorded_origin(recording) if recording.exists() else {}
    description = describe(told.get("run", "test"), driver, setup, tempo)
    if not (folder / DESCRIPTION).exists():
        write_description(folder, description)
    write_whole(folder, arrays, description)


def trace_of(setup: Setup, recording: Path) -> Trace:
    """The arrays of a recording."""
    return read_trace(setup, read_recording(recording))


def reference(setup: Setup, folder: Path) -> Trace:
    """The run in this process."""
    file = folder / "reference.mcap"
    in_this_process(setup, "reference", file, None, lambda step: None)
    return trace_of(setup, file)


def broken_promises(setup: Setup, folder: Path) -> list[str]:
    """Write the arrays of the recording in a folder; return the promises that its audit finds
    broken, with the first case of each."""
    write_arrays(folder, setup, trace_of(setup, folder / "run.mcap"))
    found = audit(folder).findings
    return [f"{one.says}: {account.first}" for one, account in found if account.broken]
