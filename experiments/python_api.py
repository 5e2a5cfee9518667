"""Functions of `import concord as cc` for one scenario; docs/python_api.md explains them."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.results.records.netcdf_file import ARRAYS, open_dataset
from concord.results.records.runs_file import runs_dataset, runs_of_dataset
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.types.option import python_words, require_kind
from concord.studies.memory import check_files, check_memory
from concord.studies.monte_carlo.side_by_side import processors
from concord.studies.monte_carlo.simulate import AGES, COV, READINGS
from concord.studies.monte_carlo.simulate import simulate as simulate_setup

if TYPE_CHECKING:
    import xarray

    from concord.studies.agree import DriverDifference


@python_words()
def scenario(name: str, **options: Any) -> Scenario:
    """The scenario of a name, or of a file (FILE.py:NAME), with options as in `concord run`.

    Options have underscores: `scenario("oscillator", nodes=4, rule="hcmci")`.

    Raises:
        ValueError: an unknown name or option; the message offers the nearest.
    """
    require_kind("scenario", name, str, "a name of `concord list`, or FILE.py:NAME")
    return scenario_of(name, **options)


@python_words()
def simulate(scenario: Scenario, runs: int = 1, *, covariances: bool = False) -> "xarray.Dataset":
    """Runs of a scenario, all at once where its rule has an array form.

    Args:
        scenario: what to run; run r has the noise of `concord run --run r`.
        runs: number of runs, from the scenario's own on.
        covariances: keep the covariances (run, step, node, state, other_state) too.

    Returns:
        truth (run, step, state), mean (run, step, node, state), nees (run, step, node) and more,
        with units; docs/results.md names every variable.

    Raises:
        ValueError: a scenario that cannot run, no run, or more than the memory holds.
    """
    _require_scenario(scenario)
    at_least_one("runs", runs)
    check_memory(scenario, runs)
    setup = prepare(scenario)
    keep = (READINGS, AGES, *((COV,) if covariances else ()))
    numbers = range(scenario.run, scenario.run + runs)
    return runs_dataset(simulate_setup(setup, numbers, keep=keep, threads=processors()))


def figures(runs: "xarray.Dataset") -> dict[str, Any]:
    """The figures of runs: those of `concord run --json`, under the same names.

    Args:
        runs: what `simulate`, `launch` or `load` returned.

    Returns:
        "verdict" with its level and cause, "rmse", "anees" and more, each [value, low, high], and
        "nodes" with those of each node; docs/results.md has the table.

    Raises:
        ValueError: a data set that holds no runs.
    """
    # Only here: most programs of Python want the arrays.
    from concord.results.figures.summary import summarise

    return msgspec.json.decode(summarise(runs_of_dataset(runs)).as_json())


@python_words()
def launch(
    scenario: Scenario, *, out: Path | str | None = None, dashboard: bool = False
) -> "xarray.Dataset":
    """Run a scenario with one process per node; the data set is that of `load`.

    Args:
        scenario: what to run. An own plant or rule must be at the top of a file, because every
            process reads it there.
        out: folder for the results; runs/<name> when left out.
        dashboard: show the run in the browser.

    Raises:
        ValueError: a scenario that cannot run, or an `out` that exists.
        NetworkFailed: a process died.
    """
    # Only here: other functions start no process.
    from concord.experiments.launching import launched
    from concord.scenarios.definitions.own import portable

    _require_scenario(scenario)
    check_memory(scenario, messages=True)
    check_files("processes", scenario.nodes)
    setup = prepare(portable(scenario))
    return load(launched(setup, None if out is None else Path(out), dashboard))


def _require_scenario(given: object) -> None:
    name = repr(given) if isinstance(given, str) else "..."
    require_kind("scenario", given, Scenario, f"a scenario, such as cc.scenario({name})")


def load(folder: Path | str) -> "xarray.Dataset":
    """The data set of a run folder, or of a file that `sweep` has written; docs/results.md and
    docs/sweeps.md name every variable. A variable is read from the file when it is first used.

    Raises:
        ValueError: the folder has no results, or they cannot be read.
    """
    require_kind("folder", folder, (str, Path), "the folder of a finished run, or a file")
    file = Path(folder) if Path(folder).is_file() else Path(folder) / ARRAYS
    if not file.is_file():
        raise ValueError(
            f"{file}: there is no such file; name the folder of a finished run, or finish an "
            f"interrupted one with `concord collect {folder}`"
        )
    return open_dataset(file, "name the folder of a finished run, or the file of a sweep")


@python_words()
def agree(scenario: Scenario) -> "tuple[DriverDifference, ...]":
    """Where the drivers differ on a scenario; empty if they agree (contract 5 of ARCHITECTURE.md).

    Raises:
        ValueError: a scenario that cannot run.
        NetworkFailed: a process died.
    """
    # Only here: other functions start no process.
    from concord.scenarios.definitions.own import portable
    from concord.studies.agree import agreement

    _require_scenario(scenario)
    return agreement(prepare(portable(scenario))).differences


def at_least_one(name: str, value: int) -> None:
    """Refuse a number below 1, or none that is whole.

    Raises:
        ValueError: naming it and its value.
    """
    require_kind(name, value, (int, np.integer), "a whole number")
    if value < 1:
        raise ValueError(f"{name} {value}: must be at least 1")
