"""`concord run --driver batched`: many runs at once, one folder, one table with intervals."""

import resource
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from rich.console import Console

from concord.experiments.monte_carlo.many_figures import (
    ManyFigures,
    RunCost,
    lines,
    summarise,
    table,
)
from concord.experiments.monte_carlo.simulate import (
    AGES,
    COV,
    READINGS,
    Histories,
    Interrupted,
    simulate,
)
from concord.experiments.progress import progress
from concord.experiments.results.folder import Description, write_whole
from concord.runtime.batched.build import without_array_form
from concord.scenarios.catalogue import definition_of
from concord.scenarios.setup import Setup

if TYPE_CHECKING:
    import xarray


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
    keep = (READINGS, AGES, *((COV,) if covariances else ()))
    stopped: KeyboardInterrupt | None = None
    try:
        with progress(setup.scenario.name, runs * setup.scenario.steps) as on_progress:
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
    write_whole(folder, histories_dataset(histories), description)
    _show(summarise(histories, RunCost(seconds, peak_memory_mb)), setup, as_json)
    if stopped is not None:
        raise stopped


def histories_dataset(histories: Histories) -> "xarray.Dataset":
    """Return the histories with named dimensions and units."""
    # Loading xarray can take longer than a run, so it is loaded only to write a file.
    import xarray

    setup = histories.setup
    definition = definition_of(setup.scenario)
    plant = definition.plant(setup.scenario)
    names = list(plant.state_names)
    state = ("run", "step", "node", "state")
    per_share = ("run", "step", "round", "node")
    variables: dict[str, Any] = {
        "truth": (("run", "step", "state"), histories.truth),
        "mean": (state, histories.mean),
        "cov_trace": (state[:-1], histories.cov_trace),
        "nees": (
            state[:-1],
            histories.nees,
            {"states": [names[i] for i in definition.score.nees_states]},
        ),
        "payload_bytes": (per_share, histories.payload_bytes, {"units": "B"}),
        "asked": (per_share, histories.asked.astype(np.int8)),
        **{
            name.replace(" ", "_").replace("-", "_"): (("run", "node"), counts)
            for name, counts in histories.counters.items()
        },
    }
    if histories.control is not None:
        variables["control"] = (("run", "step", "input"), histories.control)
    if histories.readings is not None:
        dimensions = ("run", "step", "node", "reading", "channel")
        variables["readings"] = (dimensions, histories.readings)
    if histories.ages is not None:
        units = {"units": "communication cycles"}
        variables["ages"] = (("run", "step", "link"), histories.ages, units)
    if histories.cov is not None:
        variables["cov"] = ((*state, "other_state"), histories.cov)
    heard = setup.neighbours
    coordinates = {
        "run": histories.runs,
        "step": np.arange(setup.scenario.steps),
        "time": ("step", np.arange(setup.scenario.steps) * setup.time_step_s, {"units": "s"}),
        "state": names,
        "state_unit": ("state", list(plant.state_units)),
        "receiver": ("link", np.repeat(np.arange(len(heard)), [len(some) for some in heard])),
        "sender": ("link", np.array([j for some in heard for j in some], dtype=np.int64)),
    }
    return xarray.Dataset(variables, coordinates)


def _show(figures: ManyFigures, setup: Setup, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(figures).decode() + "\n")
        return
    console = Console()
    scenario = setup.scenario
    title = (
        f"{scenario.name}: {scenario.nodes} nodes, {scenario.network.graph}, {scenario.rule.name}, "
        f"{scenario.rounds} rounds, seed {scenario.seed}, batched"
    )
    console.print(table(figures, title))
    for line in lines(figures):
        console.print(line, highlight=False)
