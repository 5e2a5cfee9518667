"""The spread of a sweep's figures over placements: each is one drawing of where sensors stand."""

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval, positive_mean_t
from concord.studies.sweep.specification import named
from concord.studies.sweep.summary import SweepFigures

FIELD = "placement"


class PlacementSpread(msgspec.Struct, frozen=True):
    """Cells that differ in their placement alone.

    `to_centralised` is the mean over placements with its 95 % interval; `least` and `greatest` are
    those of single placements.
    """

    cell: dict[str, str | float | int | bool | None]
    placements: int
    to_centralised: Interval
    least: float
    greatest: float


def over_placements(figures: SweepFigures) -> list[PlacementSpread]:
    """The spread of each group of cells with two or more placements, in the order of the cells."""
    ratios: dict[str, list[float]] = {}
    cells: dict[str, dict[str, str | float | int | bool | None]] = {}
    for one in figures.cells:
        if FIELD in one.cell:
            others = {name: value for name, value in one.cell.items() if name != FIELD}
            cells[named(others)] = others
            ratios.setdefault(named(others), []).append(one["to_centralised"].value)
    return [
        PlacementSpread(
            cells[name], len(found), positive_mean_t(np.array(found)), min(found), max(found)
        )
        for name, found in ratios.items()
        if len(found) > 1
    ]


def in_words(spread: PlacementSpread) -> str:
    """The spread as one line."""
    mean = spread.to_centralised
    cell = f"{named(spread.cell)}: " if spread.cell else ""
    return (
        f"over {spread.placements} placements, {cell}{mean.value:.3g} {mean.spread()} x central; "
        f"single placements {spread.least:.3g} to {spread.greatest:.3g}"
    )
