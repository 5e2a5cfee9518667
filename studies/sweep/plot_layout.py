"""Which swept field is which part of a picture: the colour, the axis, the panels."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from concord.studies.sweep.results import dimensions_of, flattened, specification_of
from concord.studies.sweep.specification import Cell, Value, shown

if TYPE_CHECKING:
    import xarray

# Readers compare these fields first.
_COLOUR_FIRST = ("rule", "weights", "hold", "schedule", "graph")
_PANEL_FIRST = ("graph", "rule", "schedule", "weights")
_AXIS_FIRST = ("occupancy", "rounds", "loss", "nodes")
MOST_LINES = 7

CellResult = tuple[Cell, "xarray.Dataset"]


class Layout(NamedTuple):
    """Fields of a picture; None where there is none. `rest` are drawn at their first value."""

    colour: str | None
    axis: str | None
    panel: str | None
    rest: tuple[str, ...]


def levels_of(dataset: "xarray.Dataset") -> dict[str, list[Value]]:
    """Return the swept fields and their values; for a Latin hypercube those that its cells have."""
    specification = specification_of(dataset)
    if not specification.samples:
        return dict(specification.levels)
    cells = [cell for cell, _ in flattened(dataset)]
    return {
        field: sorted({cell.values[field] for cell in cells}, key=_order)
        for field in specification.dimensions
    }


def layout_of(dataset: "xarray.Dataset") -> Layout:
    """Return the layout that shows most of a result."""
    levels = levels_of(dataset)
    numbers = [field for field, of in levels.items() if all(map(is_number, of))]
    axis = _first(_AXIS_FIRST, numbers)
    left = [field for field in levels if field != axis]
    colour = _first(_COLOUR_FIRST, [f for f in left if len(levels[f]) <= MOST_LINES])
    left = [field for field in left if field != colour]
    panel = _first(_PANEL_FIRST, [f for f in left if f not in numbers] or left)
    return Layout(colour, axis, panel, tuple(f for f in left if f != panel))


def is_number(value: Value) -> bool:
    """Return whether a value can stand on an axis."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def drawn(parts: list[CellResult], layout: Layout) -> list[CellResult]:
    """Return the parts at the first value of each field that the picture has no room for."""
    if not parts:
        return []
    first = parts[0][0].values
    return [p for p in parts if all(p[0].values[field] == first[field] for field in layout.rest)]


def grouped(parts: list[CellResult], field: str | None) -> dict[str, list[CellResult]]:
    """The parts by the value of a field, in order; all together under no name without one."""
    groups: dict[str, list[CellResult]] = {}
    for cell, data in parts:
        key = "" if field is None else shown(cell.values[field])
        groups.setdefault(key, []).append((cell, data))
    return groups


def subtitle(dataset: "xarray.Dataset", layout: Layout) -> str:
    """Return a picture's subtitle: scenario, seed, runs, and the parts that it leaves out."""
    parts = flattened(dataset)
    scenario = parts[0][0].scenario
    fixed = [f"{field}={shown(parts[0][0].values[field])}" for field in layout.rest]
    shown_alone = f"; drawn at {', '.join(fixed)}" if fixed else ""
    nodes = "" if "nodes" in dimensions_of(dataset) else f", {scenario.nodes} nodes"
    name = "" if "scenario" in dimensions_of(dataset) else scenario.name
    runs = specification_of(dataset).runs
    return f"{name}{nodes}, {runs} runs, seed {dataset.attrs['seed']}{shown_alone}"


def _first(wanted: tuple[str, ...], there: list[str]) -> str | None:
    return next((f for f in wanted if f in there), there[0] if there else None)


def _order(value: Value) -> tuple[int, float, str]:
    if is_number(value):
        return (0, float(np.float64(value)), "")  # type: ignore[arg-type]
    return (1, 0.0, str(value))
