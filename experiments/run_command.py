"""`concord run`: one scenario, one driver, one folder of results, one table of figures."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.collect_command import completed, finish
from experiments.drivers import DRIVERS, Pace
from experiments.launcher import NetworkFailed
from experiments.options import ScenarioOptions
from experiments.progress import progress
from experiments.results import (
    RECORDING,
    describe,
    make_folder,
    new_name,
    write_description,
)
from experiments.user_errors import user_errors
from nodes.links import names, ports_from
from scenarios.setup import prepare
from scenarios.warnings import known_failures


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
        if options.port is not None:
            ports_from(options.port, names(setup.neighbours))
        name = new_name(setup.scenario.name)
        description = describe(name, options.driver, setup)
        # Described first: a folder is never without its description.
        folder = make_folder(options.out, name)
        write_description(folder, description)
    sys.stderr.write(f"seed {setup.scenario.seed}; results in {folder}\n")
    for failure in known_failures(setup):
        sys.stderr.write(f"warning: {failure}\n")
    pace = Pace(None, None)
    try:
        with progress(f"{setup.scenario.name}", setup.scenario.steps) as on_step, user_errors():
            driver = DRIVERS[options.driver]
            pace = driver(setup, name, folder / RECORDING, options.port, on_step)
    except NetworkFailed as error:
        sys.stderr.write(f"concord: {error}; `concord collect {folder}` shows what was done\n")
        sys.exit(1)
    except KeyboardInterrupt:
        # Who is in a hurry is not made to wait for arrays and figures.
        sys.stderr.write(f"interrupted; `concord collect {folder}` shows what was done\n")
        raise
    finish(folder, description, completed(folder, description), pace, options.json)
