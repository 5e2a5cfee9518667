"""`concord run --driver batched`: many runs at once, one folder, one table with intervals."""

import resource
import shutil
import sys
import time
from pathlib import Path

import msgspec

from concord.experiments.standard_output import plain_console
from concord.results.folder import Description, write_whole
from concord.results.records.histories import RunCost
from concord.results.records.histories_file import histories_dataset
from concord.runtime.batched.build import without_array_form
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.many_figures import (
    ManyFigures,
    lines,
    summarise,
    table,
)
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
    runs: int,
    folder: Path,
    description: Description,
    covariances: bool,
    as_json: bool,
) -> None:
    """Simulate, write run.nc, print the figures."""
    numbers = range(setup.scenario.run, setup.scenario.run + runs)
    if (lacking := without_array_form(setup.scenario)) is not None:
        sys.stderr.write(f"{lacking} has no array form: runs go one by one, message by message\n")
    started = time.monotonic()
    keep = (READINGS, AGES, INNOVATIONS, *((COV,) if covariances else ()))
    stopped: KeyboardInterrupt | None = None
    try:
        with progress(
            setup.scenario.name, runs * setup.scenario.steps, as_json=as_json
        ) as on_progress:
            histories = simulate(setup, numbers, keep=keep, on_progress=on_progress)
    except KeyboardInterrupt as interrupted:
        kept = interrupted.histories if isinstance(interrupted, Interrupted) else None
        if kept is None:
            # Runs go on side by side, and of these none is complete.
            shutil.rmtree(folder)
            sys.stderr.write(f"interrupted before a run was complete; {folder} is removed\n")
            raise
        histories, stopped = kept, interrupted
        sys.stderr.write(
            f"interrupted: {len(histories.runs)} of {runs} runs are complete, {numbers[0]} to "
            f"{histories.runs[-1]}; {folder} keeps them\n"
        )
    seconds = time.monotonic() - started
    peak_memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    # The file is written first, because a second Ctrl-C may end the program before the table.
    cost = RunCost(seconds, peak_memory_mb)
    write_whole(folder, histories_dataset(histories, cost), description)
    _show(summarise(histories, cost), setup, as_json)
    if stopped is not None:
        raise stopped


def _show(figures: ManyFigures, setup: Setup, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(figures).decode() + "\n")
        return
    console = plain_console()
    scenario = setup.scenario
    title = (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, batched"
    )
    console.print(table(figures, title))
    for line in lines(figures):
        console.print(line)
    if figures.verdict is not None:
        console.print(f"verdict: {figures.verdict}", style="bold")
