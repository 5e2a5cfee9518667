"""`concord sweep`: every combination of what is swept, with intervals, in one file of results."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tyro
from rich.console import Console

from concord.experiments.few_samples import few_runs, few_steps
from concord.experiments.progress import progress
from concord.experiments.scenario_flags import said_in
from concord.experiments.sweep.engines import engine_for, workers_here
from concord.experiments.sweep.options import FieldOptions
from concord.experiments.sweep.placements import in_words, over_placements
from concord.experiments.sweep.run import Begin, Swept, begin, finish
from concord.experiments.sweep.specification import specify
from concord.experiments.sweep.store import folder_of
from concord.experiments.sweep.summary import figures_of, table
from concord.experiments.sweep.workers import WorkerLost
from concord.experiments.user_errors import user_errors
from concord.runtime.disk import NotWritten
from concord.scenarios.preparation import prepare
from concord.scenarios.warnings import warnings_of

FILE_WIDTH = 120


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """How much, where, and what to print."""

    runs: int = 20
    """Monte-Carlo runs of every cell. Run r has the same noise in every cell."""
    first_run: int = 0
    """Number of the first of them: 1000 gives runs that no sweep of fewer has seen."""
    latin_hypercube: int | None = None
    """So many cells spread over the values and ranges (0.1..1) instead of every combination."""
    change_step: int = 0
    """The step from which settling is timed."""
    interval: Literal["t", "bootstrap"] = "t"
    """How intervals over runs are made."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """netCDF file for the result; runs/sweep-<date>.nc when left out. The same command goes on
    with a sweep that was interrupted."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    dask: str | None = None
    """Address of a Dask scheduler whose workers compute instead: tcp://HOST:8786."""
    json: bool = False
    """Print one JSON object instead of a table."""


def sweep(
    fields: Annotated[FieldOptions, tyro.conf.arg(name="")],
    output: Annotated[SweepOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Run every combination of the given values, and print how good and how dear each is."""
    out = output.out or Path("runs") / f"sweep-{time.strftime('%Y%m%d-%H%M%S')}.nc"
    with user_errors():
        specification = specify(
            said_in(fields),
            runs=output.runs,
            first_run=output.first_run,
            samples=output.latin_hypercube,
            change_step=output.change_step,
        )
        engine = engine_for(output.workers, output.dask)
        begun = begin(specification, out, workers_here(output.workers, output.dask))
    _announce(begun, out)
    total = specification.runs * len(begun.cells)
    try:
        with progress("runs", total) as on_runs:
            swept = finish(begun, engine, on_runs)
    except KeyboardInterrupt:
        sys.stderr.write(f"interrupted; finished cells are kept in {folder_of(out)}, and the same "
                         f"command goes on from there: add -o {out}\n")  # fmt: skip
        raise
    except (WorkerLost, NotWritten) as error:
        sys.stderr.write(f"concord: {error}; finished cells are kept in {folder_of(out)}\n")
        sys.exit(1)
    _show(swept, output, out)


def _announce(begun: Begin, out: Path) -> None:
    specification, _, folder, cells, done = begun
    seeds = sorted({cell.scenario.seed for cell in cells})
    write = sys.stderr.write
    write(f"seed {', '.join(map(str, seeds))}; {len(cells)} cells of {specification.runs} runs; "
          f"results in {out}\n")  # fmt: skip
    if folder is None:
        write("this very sweep is finished: nothing is computed again\n")
        return
    if done:
        write(f"goes on: {len(done)} of {len(cells)} cells were finished before\n")
    for warning, names in _warnings(begun).items():
        more = f" and in {len(names) - 1} more" if len(names) > 1 else ""
        write(f"warning: {names[0]}{more}: {warning}\n")
    for warning in few_runs(specification.runs):
        write(f"warning: {warning}\n")


def _warnings(begun: Begin) -> dict[str, list[str]]:
    """Return the cells that are known to fail, to change nothing or to be short, by warning."""
    found: dict[str, list[str]] = {}
    for cell in begun.cells:
        for warning in (*warnings_of(prepare(cell.scenario)), *few_steps(cell.scenario)):
            found.setdefault(warning, []).append(cell.name)
    return found


def _show(swept: Swept, options: SweepOptions, out: Path) -> None:
    figures = figures_of(swept.dataset, options.interval)
    spreads = over_placements(figures)
    took: dict[str, Any] = {
        "computed_cells": swept.computed_cells,
        "found_cells": swept.found_cells,
        "seconds": swept.seconds,
        "node_updates": swept.node_updates,
    }
    rate = swept.node_updates / swept.seconds if swept.seconds else 0.0
    if options.json:
        over = msgspec.to_builtins(spreads)
        whole = {**msgspec.to_builtins(figures), "over_placements": over, **took,
                 "node_updates_per_second": rate, "result": str(out)}  # fmt: skip
        sys.stdout.write(msgspec.json.encode(whole).decode() + "\n")
        return
    console = Console()
    # A file or a pipe has no width to keep to.
    console = console if console.is_terminal else Console(width=FILE_WIDTH)
    console.print(table(figures, swept.dataset, console.width))
    for one in spreads:
        console.print(in_words(one), highlight=False, soft_wrap=True)
    if swept.computed_cells:
        console.print(
            f"computed {swept.computed_cells} of {len(figures.cells)} in {swept.seconds:.1f} s: "
            f"{swept.node_updates} node-updates, {rate:.3g} per second", highlight=False,
        )  # fmt: skip
    console.print(f"result in {out}; `concord plot {out}` draws it", highlight=False)
