"""A run over processes from Python: its folder, its results, and the dashboard beside it.

Reason for a file of its own: it starts processes, which other functions of Python do without.
"""

from functools import partial
from pathlib import Path

from concord.experiments.page_process import PageProcess
from concord.results.figures.summary import heard_by_all
from concord.results.folder import describe, new_folder, write_description
from concord.results.records.netcdf_file import RECORDING
from concord.results.records.runs import runs_of_trace
from concord.results.run_results import completed, write_results
from concord.runtime.drivers import over_processes
from concord.scenarios.setup import Setup

_HTTP_PORT = 8080


def launched(setup: Setup, out: Path | None, dashboard: bool) -> Path:
    """Run a setup with one process per node; return the folder of its results.

    Raises:
        ValueError: `out` exists, or no node completed a step.
        NetworkFailed: a process died.
    """
    name, folder = new_folder(out, setup.scenario.name)
    description = describe(name, "processes", setup)
    write_description(folder, description)
    page = PageProcess(_HTTP_PORT)
    try:
        on_paused = partial(page.start, folder) if dashboard else None
        recording = folder / RECORDING
        over_processes(setup, name, recording, None, lambda _: None, on_paused=on_paused)
    finally:
        page.close()
    trace = completed(folder, description)
    runs = runs_of_trace(setup, trace)
    write_results(folder, description, trace, runs, heard=heard_by_all(runs))
    return folder
