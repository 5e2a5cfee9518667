"""A swept result as the page of a sweep needs it, and the choices of its viewers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from concord.dashboard.digits import rounded
from concord.dashboard.theme import GREEN, ORANGE, PINK, VERMILION, Colour, Theme

GLYPHS = "●■▲◆▼✚★"
"""Signs of the values of a field, each with a colour of its own."""
FieldValue = str | float | int | bool | None


class CellQuantity(NamedTuple):
    """A figure of all cells: `intervals` (C, 3) has each value with the ends of its interval.

    At `reference` the page draws a line; None where no value is special.
    """

    name: str
    intervals: np.ndarray
    reference: float | None = None


class SweptCells(NamedTuple):
    """A sweep of C cells of R runs.

    Attributes:
        title: what was swept, in words.
        unit: the unit of the errors.
        fields: the values of each swept field in the cells, by its name.
        quantities: figures of the cells.
        colour: the field that is told apart by colour at first, "" for none.
        runs: (R,) the numbers of the runs.
        rmse: (C, R) of each run, NaN where a sweep kept moments only.
        times: (T,) of the steps in seconds.
        errors: RMSE over the runs (C, T) by the name of its line.
    """

    title: str
    unit: str
    fields: Mapping[str, Sequence[FieldValue]]
    quantities: tuple[CellQuantity, ...]
    colour: str
    runs: np.ndarray
    rmse: np.ndarray
    times: np.ndarray
    errors: Mapping[str, np.ndarray]

    def levels(self, name: str) -> list[FieldValue]:
        """Return the values of a field that occur, numbers in order."""
        found = list(dict.fromkeys(self.fields[name]))
        return sorted(found) if all(map(is_number, found)) else found  # type: ignore[type-var]

    def words(self, cell: int) -> str:
        """Return a cell in the words of its fields."""
        return ", ".join(f"{name}={worded(of[cell])}" for name, of in self.fields.items()) or "all"

    def middle_run(self, cell: int) -> int:
        """Return the place of the run nearest the median RMSE of a cell; 0 if that is unknown."""
        rmse = self.rmse[cell]
        if np.isnan(rmse).all():
            return 0
        return int(np.nanargmin(np.abs(rmse - np.nanmedian(rmse))))


@dataclass
class Choices:
    """Choices of the viewers of a page; `limits` has the values of a field that are shown; `width`
    and `height` are those of the picture in pixels."""

    theme: Theme
    across: str
    up: str
    colour: str
    selected: int | None = None
    hovered: int | None = None
    width: float = 900.0
    height: float = 560.0
    limits: dict[str, tuple[FieldValue, ...]] = field(default_factory=dict)


def shown_cells(swept: SweptCells, choices: Choices) -> np.ndarray:
    """Return which cells (C,) lie within all limits."""
    shown = np.ones(len(swept.rmse), dtype=bool)
    for name, allowed in choices.limits.items():
        shown &= [value in allowed for value in swept.fields[name]]
    return shown


def looks(swept: SweptCells, choices: Choices) -> list[tuple[str, Colour]]:
    """Return the glyph and the colour of each cell."""
    theme = choices.theme
    plain = [(GLYPHS[0], theme.seeing)] * len(swept.rmse)
    if choices.colour not in swept.fields:
        return plain
    levels = swept.levels(choices.colour)
    if len(levels) > len(GLYPHS):
        return plain
    colours = (theme.seeing, ORANGE, GREEN, PINK, VERMILION, theme.truth, theme.quiet)
    look = dict(zip(levels, zip(GLYPHS, colours, strict=True), strict=False))
    return [look[value] for value in swept.fields[choices.colour]]


def is_number(value: object) -> bool:
    """Return whether a value can stand on an axis of numbers."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def worded(value: object) -> str:
    """Return a value in a few characters."""
    return rounded(float(value), 4) if isinstance(value, float | np.floating) else str(value)
