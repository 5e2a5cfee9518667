"""A sweep from its specification to its result: cells that are not there yet are computed."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.experiments.sweep.cells import checked_cells
from concord.experiments.sweep.pieces import Piece, compute, joined, pieces_of
from concord.experiments.sweep.results import (
    assemble,
    read_result,
    score_unit,
    specification_of,
    write_result,
)
from concord.experiments.sweep.specification import Cell, Specification
from concord.experiments.sweep.store import (
    check_same,
    load_cells,
    open_store,
    remove_store,
    save_cell,
)
from concord.experiments.sweep.workers import Engine
from concord.scenarios.catalogue import definition_of

if TYPE_CHECKING:
    import xarray


class Swept(NamedTuple):
    """A finished sweep: what was found, and what it took to compute what was not there yet."""

    dataset: "xarray.Dataset"
    found_cells: int
    computed_cells: int
    node_updates: int
    seconds: float


class Begin(NamedTuple):
    """A sweep that is ready to run: every cell checked, those done before loaded."""

    specification: Specification
    out: Path | None
    folder: Path | None
    cells: list[Cell]
    done: dict[int, dict[str, np.ndarray]]


def begin(specification: Specification, out: Path | None, workers: int = 1) -> Begin:
    """Check every cell, and find what an earlier start of the same sweep left; None keeps nothing.
    So many worker processes on this machine are to compute it.

    Raises:
        ValueError: a cell that cannot run, or an `out` that belongs to another sweep.
    """
    cells = checked_cells(specification, workers)
    score_unit([definition_of(cell.scenario) for cell in cells])
    if out is None:
        return Begin(specification, None, None, cells, {})
    if out.exists():
        before = specification_of(read_result(out))
        check_same(before, specification, out, "remove it")
        return Begin(specification, out, None, cells, {})
    folder = open_store(out, specification)
    return Begin(specification, out, folder, cells, load_cells(folder, [c.number for c in cells]))


def finish(begun: Begin, engine: Engine, on_runs: Callable[[int], None]) -> Swept:
    """Compute what is missing and write the result; `on_runs` is told how many runs are done.

    A finished cell is kept at once: whatever ends this, `begin` finds it again.
    """
    specification, out, folder, cells, done = begun
    if out is not None and folder is None:
        return Swept(read_result(out), len(cells), 0, 0, 0.0)
    found = len(done)
    figures = dict(done)
    missing = [cell for cell in cells if cell.number not in done]
    pieces = pieces_of(specification, missing)
    started = time.monotonic()
    waiting = {cell.number: sum(p.cell == cell.number for p in pieces) for cell in missing}
    parts: dict[int, list[tuple[Piece, dict[str, np.ndarray]]]] = {c.number: [] for c in missing}
    runs = specification.runs * found
    on_runs(runs)
    for place, result in engine(compute, pieces):
        piece = pieces[place]
        parts[piece.cell].append((piece, result))
        if len(parts[piece.cell]) == waiting[piece.cell]:
            ordered = sorted(parts.pop(piece.cell), key=lambda part: part[0].first)
            figures[piece.cell] = joined([part for _, part in ordered])
            if folder is not None:
                save_cell(folder, piece.cell, figures[piece.cell])
        runs += piece.last - piece.first
        on_runs(runs)
    seconds = time.monotonic() - started
    dataset = assemble(specification, cells, figures)
    if out is not None:
        write_result(dataset, out)
        remove_store(out)
    updates = sum(c.scenario.nodes * c.scenario.steps for c in missing) * specification.runs
    return Swept(dataset, found, len(missing), updates, seconds)
