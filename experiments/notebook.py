"""concord from Python: what the commands do, with values in and data sets out.

    from experiments.notebook import sweep
    result = sweep(scenario="oscillator", graph=["ring", "path"], runs=20)
    result.rmse.mean("run")

Nothing here starts processes or writes files unless it is asked to. docs/python_api.md has more.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.design.candidates import Cost
from experiments.design.results import Design, design_of
from experiments.design.search import SearchTask, search
from experiments.design.space import space_of
from experiments.design.target import parse_target
from experiments.monte_carlo.simulate import Histories
from experiments.monte_carlo.simulate import simulate as simulate_setup
from experiments.scenario_options import scenario_of
from experiments.sweep.engines import engine_for
from experiments.sweep.run import begin, finish
from experiments.sweep.specification import Specification, Value, shown, specify
from scenarios.preparation import prepare

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

SweptValues = Value | Sequence[Value]


def simulate(scenario: str = "target-tracking", runs: int = 1, **fields: Value) -> Histories:
    """Runs of one scenario as arrays, (runs, steps, nodes, ...); fields as in `concord run`.

    Raises:
        ValueError: a scenario that cannot run.
    """
    return simulate_setup(prepare(scenario_of(scenario, **fields)), range(runs))


def sweep(
    *,
    runs: int = 20,
    samples: int | None = None,
    workers: int = 1,
    out: Path | str | None = None,
    **fields: SweptValues,
) -> "xarray.Dataset":
    """Every combination of the fields' values; docs/sweeps.md names the variables.

    Args:
        runs: of each cell, with the same noise in every cell.
        samples: so many cells of a Latin hypercube instead.
        workers: processes; with more than one, a script needs `if __name__ == "__main__":`.
        out: netCDF file to keep the result and, on the way, each finished cell in.
        fields: one value, or several in a list; ranges as text, "0.1..1".

    Raises:
        ValueError: a cell that cannot run, or an `out` that belongs to another sweep.
    """
    specification = _specification(fields, runs, samples)
    begun = begin(specification, None if out is None else Path(out))
    return finish(begun, engine_for(workers, None), lambda _: None).dataset


def design(
    target_rmse: str,
    *,
    minimise: Cost = "occupancy",
    runs: int = 100,
    workers: int = 1,
    **fields: SweptValues,
) -> Design:
    """The cheapest network that meets an error target; its `recommended` is None if none does.

    Raises:
        ValueError: a target that is none, or no candidate that can run.
    """
    target = parse_target(target_rmse)
    settled, space = space_of(_specification(fields, runs, None))
    engine = engine_for(workers, None)
    task = SearchTask(target, minimise, settled, space, runs, engine, lambda _: None)
    return design_of(settled, target, minimise, search(task, [], []), True)


def plots(result: "xarray.Dataset | Design") -> "dict[str, Figure]":
    """Return the pictures of a result by name."""
    if isinstance(result, Design):
        from experiments.design.plots import design_figures

        return design_figures(result)
    from experiments.sweep.plots import sweep_figures

    return sweep_figures(result)


def _specification(fields: dict[str, SweptValues], runs: int, samples: int | None) -> Specification:
    asked = {
        name: shown(values)
        if isinstance(values, str) or not isinstance(values, Sequence)
        else ",".join(map(shown, values))
        for name, values in fields.items()
    }
    return specify(asked, runs=runs, samples=samples)
