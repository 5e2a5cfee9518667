"""The figures of a sweep's cells with their intervals: values for machines, a table for people."""

from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from concord.results.figures.figure_table import FIGURES, SWEPT
from concord.results.figures.intervals import Interval
from concord.results.figures.summary import level_of
from concord.results.verdict.findings import VerdictLevel
from concord.scenarios.catalogue import definition_named
from concord.studies.monte_carlo.moments import PAIRS
from concord.studies.sweep.cell_data import CellData
from concord.studies.sweep.results import flattened, specification_of
from concord.studies.sweep.specification import shown

if TYPE_CHECKING:
    import xarray


_OF_RUNS = tuple(name for name in SWEPT if FIGURES[name].dimensions == ("run",))


class CellFigures(msgspec.Struct, frozen=True):
    """One cell: its fields, the level of its verdict, and its figures.

    A figure is [value, low, high] with the bounds of the interval over its runs, by the names of
    `figure_table.FIGURES` and `RATIOS`. Beside these `to_bound` and `to_best` are ratios of root
    mean squares over the same runs: to the posterior Cramer-Rao bound, to the best cell.
    `settling_steps` counts from the change (`--change-step`) until the error stays settled.
    """

    cell: dict[str, str | float | int | bool | None]
    level: VerdictLevel
    figures: dict[str, Interval]

    def __getitem__(self, name: str) -> Interval:
        """Return a figure."""
        return self.figures[name]


class SweepFigures(msgspec.Struct, frozen=True):
    """All cells, in order. RMSE and disagreement are in `unit`."""

    unit: str
    runs: int
    seed: int | str
    interval: str
    cells: list[CellFigures]


def figures_of(dataset: "xarray.Dataset", method: str = "t") -> SweepFigures:
    """Return the figures of a result; `method` is one of `intervals.METHODS`."""
    parts = [(cell, CellData(part, method)) for cell, part in flattened(dataset)]
    errors = np.array([part.rms("rmse") for _, part in parts])
    best = parts[int(np.nanargmin(errors)) if not np.isnan(errors).all() else 0][1]
    specification = specification_of(dataset)
    return SweepFigures(
        unit=dataset["rmse"].attrs["units"],
        runs=specification.runs,
        seed=_plain(dataset.attrs["seed"]),
        interval=method,
        cells=[
            _figures(dict(cell.values), part, best, specification.change_step,
                     _first_scored(cell.scenario.name))
            for cell, part in parts
        ],
    )  # fmt: skip


def _figures(
    cell: dict[str, Any], part: CellData, best: CellData, change_step: int, first: int
) -> CellFigures:
    steps = ~np.isnan(part.rms("error"))
    squares = np.square(part.values("bound")[steps])[min(first, steps.sum() - 1) :]
    bound = squares.mean() if len(squares) else np.nan  # a log without a truth has no error
    figures = {
        **{name: part.interval(name) for name in _OF_RUNS},
        **{name: part.ratio(*pair) for name, pair in PAIRS.items()},
        "to_bound": part.root_mean("rmse", float(np.sqrt(bound))),
        "to_best": part.to(best, "rmse"),
        "settling_steps": part.settling(change_step),
    }
    return CellFigures(cell, level_of(figures), figures)


def as_json(figures: SweepFigures) -> dict[str, Any]:
    """Return the figures as one JSON object, in which those of a cell stand beside its fields."""
    cells = [{"cell": cell.cell, "level": cell.level, **cell.figures} for cell in figures.cells]
    return {**msgspec.structs.asdict(figures), "cells": cells}


def _plain(seed: object) -> int | str:
    return seed if isinstance(seed, str) else int(seed)  # type: ignore[arg-type]


def _first_scored(name: str) -> int:
    return definition_named(name).score.first_step


def table(figures: SweepFigures, dataset: "xarray.Dataset", width: int) -> Table:
    """One row per cell, with as many columns as `width` characters hold."""
    specification = specification_of(dataset)
    fields = specification.dimensions
    seed = figures.seed if isinstance(figures.seed, str) else f"seed {figures.seed}"
    plural = "s" if len(figures.cells) > 1 else ""
    grid = Table(
        title=f"{len(figures.cells)} cell{plural} of {figures.runs} runs, {seed}; ± half of the "
        f"95 % interval over runs ({figures.interval})",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    blind = any(np.isnan(cell["rmse"].value) for cell in figures.cells)
    unsound = any(cell.level != "WORKS" for cell in figures.cells)
    columns = {
        **({"": lambda cell: cell.level} if unsound else {}),
        f"RMSE [{figures.unit}]": lambda cell: _number(cell["rmse"].value),
        **({"from central": lambda cell: _number(cell["from_centralised"].value)} if blind else {}),
        "x central": lambda cell: _with_half(cell["to_centralised"]),
        "x best": lambda cell: "best" if _is_best(cell) else _with_half(cell["to_best"]),
        "ANEES": lambda cell: _with_half(cell["anees"]),
        **({"NIS": lambda cell: _with_half(cell["nis"])} if blind else {}),
        "B/step": lambda cell: _number(cell["bytes_per_step"].value),
        "load %": lambda cell: _number(100 * cell["bus_load"].value),
        "disagree": lambda cell: _number(cell["disagreement"].value),
        "covered %": lambda cell: _number(100 * cell["coverage"].value),
        "settled": lambda cell: _number(cell["settling_steps"].value),
    }
    taken = sum(max(len(name), *(len(shown(c.cell[name])) for c in figures.cells)) + 2
                for name in fields)  # fmt: skip
    for name in fields:
        grid.add_column(name, no_wrap=True)
    said = []
    for heading, say in columns.items():
        texts = [say(cell) for cell in figures.cells]
        if blind and set(texts) == {"-"}:
            continue
        taken += max(len(heading), *map(len, texts)) + 2
        if said and taken > width:
            break
        grid.add_column(heading, justify="right", no_wrap=True)
        said.append(texts)
    for number, cell in enumerate(figures.cells):
        if number and len(fields) > 1 and not specification.samples:
            last = figures.cells[number - 1]
            if any(cell.cell[name] != last.cell[name] for name in fields[:-1]):
                grid.add_section()
        grid.add_row(*(shown(cell.cell[name]) for name in fields), *(t[number] for t in said))
    return grid


def _is_best(cell: CellFigures) -> bool:
    return cell["to_best"].value == 1 and not cell["to_best"].high > 1


def _with_half(interval: Interval) -> str:
    return f"{_number(interval.value)} {interval.spread()}".rstrip()


def _number(value: float) -> str:
    if np.isnan(value):
        return "-"
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"
