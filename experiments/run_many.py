"""`concord run --driver batched`: many runs at once, one folder, one table with intervals."""

import resource
import shutil
import sys
import time
from pathlib import Path

from concord.experiments.cli.collect import FiguresForm, show
from concord.results.figures.summary import Summary, summarise
from concord.results.folder import Description, write_whole
from concord.results.records.runs import RunCost
from concord.results.records.runs_file import runs_arrays
from concord.runtime.batched.build import without_array_form
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.side_by_side import processors
from concord.studies.monte_carlo.simulate import (
    AGES,
    COV,
    INNOVATIONS,
    READINGS,
    Interrupted,
    simulate,
)
from concord.studies.progress import progress


def run_many(
    setup: Setup,
    count: int,
    folder: Path,
    description: Description,
    covariances: bool,
    shown: FiguresForm,
) -> Summary:
    """Simulate, write run.nc, print the figures."""
    numbers = range(setup.scenario.run, setup.scenario.run + count)
    if (lacking := without_array_form(setup.scenario)) is not None:
        sys.stderr.write(f"{lacking} has no array form: runs go one by one, message by message\n")
    started = time.monotonic()
    keep = (READINGS, AGES, INNOVATIONS, *((COV,) if covariances else ()))
    stopped: KeyboardInterrupt | None = None
    try:
        with progress(
            setup.scenario.name, count * setup.scenario.steps, as_json=shown.as_json
        ) as on_progress:
            runs = simulate(
                setup, numbers, keep=keep, on_progress=on_progress, threads=processors()
            )
    except KeyboardInterrupt as interrupted:
        kept = interrupted.runs if isinstance(interrupted, Interrupted) else None
        if kept is None:
            # Runs go on side by side, and of these none is complete.
            shutil.rmtree(folder)
            sys.stderr.write(f"interrupted before a run was complete; {folder} is removed\n")
            raise
        runs, stopped = kept, interrupted
        sys.stderr.write(
            f"interrupted: {len(runs.runs)} of {count} runs are complete, {numbers[0]} to "
            f"{runs.runs[-1]}; {folder} keeps them\n"
        )
    seconds = time.monotonic() - started
    peak_memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    # The file is written first, because a second Ctrl-C may end the program before the table.
    cost = RunCost(seconds, peak_memory_mb)
    write_whole(folder, runs_arrays(runs, cost), description)
    figures = summarise(runs, cost)
    show(figures, description, folder, shown)
    if stopped is not None:
        raise stopped
    return figures
