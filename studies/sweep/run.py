"""A sweep from its specification to its result: pieces that are not there yet are computed."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from concord.scenarios.catalogue import definition_of
from concord.studies.sweep.cells import checked_cells
from concord.studies.sweep.pieces import (
    CellParts,
    Piece,
    compute,
    digest_of,
    pieces_of,
    program,
)
from concord.studies.sweep.results import (
    assemble,
    read_result,
    score_unit,
    specification_of,
    write_result,
)
from concord.studies.sweep.specification import Cell, Specification
from concord.studies.sweep.store import (
    check_same,
    load_arrays,
    open_store,
    remove_store,
    save_arrays,
)
from concord.studies.sweep.workers import Engine

if TYPE_CHECKING:
    import xarray

Parts = Mapping[int, CellParts]


class Shard(NamedTuple):
    """Part `number`, from 1 on, of so many that a sweep is divided into."""

    number: int
    shards: int


WHOLE = Shard(1, 1)


class Swept(NamedTuple):
    """A finished sweep: what was found, and what it took to compute what was not there yet.

    `dataset` is None for a shard that is not the whole.
    """

    dataset: "xarray.Dataset | None"
    found_pieces: int
    computed_pieces: int
    node_updates: int
    seconds: float


class Begin(NamedTuple):
    """A sweep that is ready to run: every cell checked, its pieces done before loaded.

    `folder` has its pieces; None where they are not kept, or where the result is there.
    """

    specification: Specification
    out: Path | None
    folder: Path | None
    cells: list[Cell]
    parts: Parts
    found: int
    missing: list[Piece]
    shard: Shard = WHOLE


def begin(
    specification: Specification,
    out: Path | None,
    workers: int = 1,
    pieces: Path | None = None,
    shard: Shard = WHOLE,
) -> Begin:
    """Check every cell, and find what an earlier start of the same sweep left; None keeps nothing.

    Args:
        specification: what is swept.
        out: the result.
        workers: so many processes on this machine are to compute it.
        pieces: folder of pieces that other sweeps use too; that of the result when left out.
        shard: which pieces to compute.

    Raises:
        ValueError: a cell that cannot run, or an `out` that belongs to another sweep.
    """
    cells = checked_cells(specification, workers)
    score_unit([definition_of(cell.scenario) for cell in cells])
    parts = {cell.number: CellParts() for cell in cells}
    if out is not None and out.exists():
        before = specification_of(read_result(out))
        check_same(before, specification, out, "remove it")
        return Begin(specification, out, None, cells, parts, 0, [], shard)
    every = pieces_of(specification, cells)[shard.number - 1 :: shard.shards]
    if out is None:
        return Begin(specification, None, None, cells, parts, 0, every, shard)
    folder = open_store(out, specification, shard.shards) if pieces is None else pieces
    missing = take_found(specification, every, [folder], parts)
    found = len(every) - len(missing)
    return Begin(specification, out, folder, cells, parts, found, missing, shard)


def take_found(
    specification: Specification, pieces: Sequence[Piece], folders: Sequence[Path], parts: Parts
) -> list[Piece]:
    """Put the pieces that one of the folders has in their places; return the others."""
    missing = []
    for piece in pieces:
        digest = digest_of(piece, specification.digests, program())
        loaded = (load_arrays(folder, digest) for folder in folders)
        found = next((figures for figures in loaded if figures is not None), None)
        if found is None:
            missing.append(piece)
        else:
            parts[piece.cell].add(piece, found)
    return missing


def finish(begun: Begin, engine: Engine, on_runs: Callable[[int], None]) -> Swept:
    """Compute what is missing and write the result; `on_runs` is told how many runs are done.

    A finished piece is kept at once: whatever ends this, `begin` finds it again. A shard writes no
    result.
    """
    specification, out, folder, cells, parts, found, missing, shard = begun
    if out is not None and folder is None:
        return Swept(read_result(out), len(cells), 0, 0, 0.0)
    started = time.monotonic()
    runs = sum(part.runs for part in parts.values())
    on_runs(runs)
    for place, figures in engine(compute, missing):
        piece = missing[place]
        if folder is not None:
            save_arrays(folder, digest_of(piece, specification.digests, program()), figures)
        if shard == WHOLE:
            parts[piece.cell].add(piece, figures)
        runs += piece.runs
        on_runs(runs)
    seconds = time.monotonic() - started
    sizes = {cell.number: cell.scenario.nodes * cell.scenario.steps for cell in cells}
    updates = sum(sizes[piece.cell] * piece.runs for piece in missing)
    if shard.shards > 1:
        return Swept(None, found, len(missing), updates, seconds)
    dataset = assembled(specification, cells, parts, out)
    if out is not None:
        remove_store(out)
    return Swept(dataset, found, len(missing), updates, seconds)


def assembled(
    specification: Specification, cells: Sequence[Cell], parts: Parts, out: Path | None
) -> "xarray.Dataset":
    """Return the data set of a sweep whose pieces are all there, written to `out`."""
    figures = {number: part.figures() for number, part in parts.items()}
    dataset = assemble(specification, cells, figures)
    if out is not None:
        write_result(dataset, out)
    return dataset
