"""`concord sweep`: every combination of what is swept, with intervals, in one file of results; and
`concord merge`: the same from shards."""

import csv
import math
import shlex
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import tyro

from concord.disk import RunFailed, writing
from concord.experiments.cli.help import FIRST
from concord.experiments.scenario_flags import FieldOptions, said_in
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.figures.summary import decisive_run
from concord.results.places import make_folder, new_name
from concord.scenarios.preparation import prepare
from concord.scenarios.user.trust import trust
from concord.scenarios.warnings import warnings_of
from concord.studies.few_samples import few_runs, few_steps
from concord.studies.progress import progress
from concord.studies.sweep.cell_data import CellData
from concord.studies.sweep.cells import with_keep
from concord.studies.sweep.engines import engine_for, workers_here
from concord.studies.sweep.merge import merge_shards
from concord.studies.sweep.placements import in_words, over_placements
from concord.studies.sweep.results import flattened
from concord.studies.sweep.run import WHOLE, Begin, Shard, Swept, begin, finish
from concord.studies.sweep.specification import Specification, specify
from concord.studies.sweep.summary import SweepFigures, figures_of, table
from concord.studies.sweep.summary import as_json as cells_json

if TYPE_CHECKING:
    import xarray

FILE_WIDTH = 120
_CSV = ".csv"


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """How much, where, and what to print."""

    runs: Annotated[int, FIRST] = 20
    """Monte-Carlo runs of every cell. Run r has the same noise in every cell."""
    exact: Annotated[bool, FIRST] = False
    """Expectations over all noise in place of runs: linear plants, schedules without contention. A
    run is then a pattern of losses, and without losses intervals have no width (docs/exact.md)."""
    latin_hypercube: Annotated[int | None, FIRST] = None
    """So many cells spread over the values and ranges (0.1..1) instead of every combination."""
    change_step: int = 0
    """The step from which settling is timed."""
    interval: Literal["t", "bootstrap"] = "t"
    """How intervals over runs are made."""
    keep: Literal["moments", "figures", "histories"] | None = None
    """Histories of every run, figures of every run, or moments and quantiles over the runs, whose
    size does not grow with the runs. Histories when left out, moments above 1e8 estimates."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"]), FIRST] = None
    """netCDF file for the result; runs/sweep-<date>.nc when left out. NAME.csv also writes the
    table of figures, beside NAME.nc. The same command goes on with a sweep that was interrupted."""
    pieces: Path | None = None
    """Folder that keeps the computed pieces, for other sweeps that have the same runs of the same
    cells."""
    shard: str | None = None
    """Part of the work to compute, such as 3/10; `concord merge` makes the result of all parts."""
    workers: Annotated[int | None, FIRST] = None
    """Processes on this machine; one per core when left out."""
    dask: str | None = None
    """Address of a Dask scheduler whose workers compute instead: tcp://HOST:8786."""
    dask_tls: Path | None = None
    """Folder with ca.pem, cert.pem and key.pem, for a scheduler at tls://HOST:8786."""
    dask_wait: float = 600.0
    """Seconds to wait for the first workers of the scheduler."""
    json: Annotated[bool, FIRST] = False
    """Print one JSON object instead of a table."""


def sweep(
    fields: Annotated[FieldOptions, tyro.conf.arg(name="")],
    output: Annotated[SweepOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Run all combinations of values; print error and cost."""
    asked = output.out or Path("runs") / f"{new_name('sweep')}.nc"
    out = asked.with_suffix(".nc") if asked.suffix == _CSV else asked
    with user_errors():
        specification = with_keep(
            specify(
                said_in(fields),
                runs=output.runs,
                samples=output.latin_hypercube,
                change_step=output.change_step,
                exact=output.exact,
            ),
            output.keep,
        )
        shard = _shard(output, specification)
        engine = engine_for(output.workers, output.dask, output.dask_tls, output.dask_wait)
        workers = workers_here(output.workers, output.dask)
        if output.pieces is not None:
            make_folder(output.pieces, "--pieces")
        begun = begin(specification, out, workers, output.pieces, shard)
    _announce(begun, out)
    total = sum(part.runs for part in begun.parts.values()) + sum(p.runs for p in begun.missing)
    try:
        with progress("runs", max(total, 1), as_json=output.json) as on_runs:
            swept = finish(begun, engine, on_runs)
    except KeyboardInterrupt:
        sys.stderr.write(f"interrupted; {_goes_on(output, out)}\n")
        raise
    except RunFailed as error:
        raise RunFailed(f"{error}; {_goes_on(output, out)}") from error
    if swept.dataset is None:
        _show_shard(swept, begun, output.json)
    else:
        _show(swept.dataset, swept, output.interval, output.json, out)
        if asked != out:
            _write_table(asked, figures_of(swept.dataset, output.interval))


def _write_table(path: Path, figures: SweepFigures) -> None:
    """Write a row for each cell: its values, then each figure with its interval."""
    rows: list[dict[str, object]] = []
    for one in figures.cells:
        row: dict[str, object] = {**one.cell, "unit": figures.unit, "level": one.level}
        for name, interval in one.figures.items():
            bounds = (None if math.isnan(bound) else bound for bound in interval)
            row |= dict(zip((name, f"{name}_low", f"{name}_high"), bounds, strict=True))
        rows.append(row)
    with writing(path), path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, rows[0])
        table.writeheader()
        table.writerows(rows)
    sys.stderr.write(f"table in {path}\n")


def _goes_on(output: SweepOptions, out: Path) -> str:
    """Return the command that goes on with the finished pieces, as this one was typed."""
    typed = [*sys.argv[1:], *(() if output.out is not None else ("-o", str(out)))]
    return f"finished pieces are kept; go on with: concord {shlex.join(typed)}"


@dataclass(frozen=True, kw_only=True)
class MergeOptions:
    """Folders of pieces, and the result."""

    pieces: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders that `concord sweep --shard` has made, in any order."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """netCDF file for the result. It must not exist."""
    json: bool = False
    """Print one JSON object instead of a table."""
    trust: Path | None = None
    """Folder whose own code and files may be used here: pieces of another user."""


def merge(options: Annotated[MergeOptions, tyro.conf.arg(name="")]) -> None:
    """Make the result of a sweep from the folders of its shards."""
    with user_errors():
        trust(options.trust)
        if not options.pieces:
            raise ValueError("merge: name the folders of pieces that `concord sweep --shard` made")
        if options.out.exists():
            raise ValueError(f"--out {options.out}: exists; choose another name")
        dataset = merge_shards(options.pieces, options.out)
    _show(dataset, Swept(dataset, 0, 0, 0, 0.0), "t", options.json, options.out)


def _shard(options: SweepOptions, specification: Specification) -> Shard:
    """Return the shard that the options ask for.

    Raises:
        ValueError: options that do not go together, or a shard that is none.
    """
    if options.interval == "bootstrap" and specification.keep == "moments":
        raise ValueError(
            "--interval bootstrap: needs every run, and --keep moments keeps none; use --interval "
            "t or --keep figures"
        )
    if options.shard is None:
        return WHOLE
    if options.pieces is not None or options.out is None:
        raise ValueError(
            f"--shard {options.shard}: its pieces stand beside the result, in OUT.pieces; give "
            "--out and leave --pieces out"
        )
    number, _, shards = options.shard.partition("/")
    if not (number.isdecimal() and shards.isdecimal() and 1 <= int(number) <= int(shards)):
        raise ValueError(
            f"--shard {options.shard}: must be NUMBER/SHARDS, such as 3/10, with NUMBER from 1 to "
            "SHARDS (the variable SHARDS of deploy/shards.sh)"
        )
    return Shard(int(number), int(shards))


def _announce(begun: Begin, out: Path) -> None:
    specification, cells = begun.specification, begun.cells
    seeds = sorted({cell.scenario.seed for cell in cells})
    write = sys.stderr.write
    write(f"seed {', '.join(map(str, seeds))}; {len(cells)} cells of {specification.runs} runs; "
          f"results in {out}\n")  # fmt: skip
    if begun.folder is None:
        write("this very sweep is finished: nothing is computed again\n")
        return
    if begun.found:
        every = begun.found + len(begun.missing)
        write(f"goes on: {begun.found} of {every} pieces were computed before\n")
    if specification.keep == "moments":
        write("keeps moments and quantiles over the runs; --keep figures keeps every run\n")
    _warn(
        (warning, cell.name)
        for cell in begun.cells
        for warning in (*warnings_of(prepare(cell.scenario)), *few_steps(cell.scenario))
    )
    for warning in few_runs(specification.runs):
        write(f"warning: {warning}\n")


def _warn(found: Iterable[tuple[str, str]]) -> None:
    """Print each warning once, with the first of the cells that it is of."""
    cells: dict[str, list[str]] = {}
    for warning, cell in found:
        cells.setdefault(warning, []).append(cell)
    for warning, names in cells.items():
        more = f" and in {len(names) - 1} more" if len(names) > 1 else ""
        sys.stderr.write(f"warning: {names[0]}{more}: {warning}\n")


def _decisive_runs(dataset: "xarray.Dataset") -> Iterator[tuple[str, str]]:
    for cell, part in flattened(dataset):
        data = CellData(part)
        if data.has_runs("rmse") and (warning := decisive_run(data.values("rmse"))):
            yield warning, cell.name


def _show_shard(swept: Swept, begun: Begin, as_json: bool) -> None:
    number, shards = begun.shard
    if as_json:
        found = {"shard": number, "shards": shards, "computed_pieces": swept.computed_pieces,
                 "found_pieces": swept.found_pieces, "seconds": swept.seconds,
                 "pieces": str(begun.folder)}  # fmt: skip
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
        return
    sys.stdout.write(
        f"shard {number} of {shards}: {swept.computed_pieces} pieces in {swept.seconds:.1f} s, in "
        f"{begun.folder}; when all shards are done, `concord merge {begun.folder} -o {begun.out}` "
        "makes the result\n"
    )


def _show(dataset: "xarray.Dataset", swept: Swept, interval: str, as_json: bool, out: Path) -> None:
    figures = figures_of(dataset, interval)
    _warn(_decisive_runs(dataset))
    spreads = over_placements(figures)
    took: dict[str, Any] = {
        "computed_pieces": swept.computed_pieces,
        "found_pieces": swept.found_pieces,
        "seconds": swept.seconds,
        "node_updates": swept.node_updates,
    }
    rate = swept.node_updates / swept.seconds if swept.seconds else 0.0
    if as_json:
        over = msgspec.to_builtins(spreads)
        whole = {**cells_json(figures), "over_placements": over, **took,
                 "node_updates_per_second": rate, "result": str(out)}  # fmt: skip
        sys.stdout.write(msgspec.json.encode(whole).decode() + "\n")
        return
    console = plain_console(FILE_WIDTH)
    console.print(table(figures, dataset, console.width))
    for one in spreads:
        console.print(in_words(one), soft_wrap=True)
    if swept.computed_pieces:
        every = swept.found_pieces + swept.computed_pieces
        console.print(
            f"computed {swept.computed_pieces} of {every} pieces in {swept.seconds:.1f} s: "
            f"{swept.node_updates} node-updates, {rate:.3g} per second",
        )  # fmt: skip
    console.print(f"result in {out}; `concord plot {out}` draws it")
