"""The result of a sweep: one xarray data set, one dimension per swept field, and the runs.

Where a sweep keeps moments, statistics over the runs take the place of the runs.

Cells of a Latin hypercube have one dimension, `cell`, along which the fields are coordinates.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from concord.results.figures.figure_table import FIGURES, RATIOS, SWEPT, Figure
from concord.results.folder import provenance
from concord.results.records.netcdf_file import read_dataset, write_dataset
from concord.scenarios.catalogue import definition_of
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.user.trust import UnknownCode, require_known
from concord.studies.monte_carlo.moments import (
    PAIR_STATISTICS,
    PAIRS,
    STATISTICS,
    statistics_of,
)
from concord.studies.sweep.pieces import REDUCED
from concord.studies.sweep.specification import Cell, Specification, Value, cells_of

if TYPE_CHECKING:
    import xarray

SPECIFICATION = "specification"


def assemble(
    specification: Specification,
    cells: Sequence[Cell],
    figures: Mapping[int, dict[str, np.ndarray]],
) -> "xarray.Dataset":
    """Return the data set of a sweep from the figures of its cells; what a cell has not is NaN.

    Raises:
        ValueError: errors of different units, which cannot stand in one table.
    """
    import xarray

    fields = _fields(specification, cells)
    shape = tuple(len(values) for values in fields.values())
    definitions = [definition_of(cell.scenario) for cell in cells]
    states = _states(cells, definitions)
    table = table_of(specification.keep)
    sizes = {
        "run": specification.runs,
        "step": max(cell.scenario.steps for cell in cells),
        "node": max(cell.scenario.nodes for cell in cells),
        "state": len(states),
        "statistic": len(STATISTICS),
        "pair_statistic": len(PAIR_STATISTICS),
    }
    unit = score_unit(definitions)
    wholes = {
        name: np.full((*shape, *(sizes[d] for d in figure.dimensions)), np.nan)
        for name, figure in table.items()
    }
    for cell in cells:
        place = np.unravel_index(cell.number, shape) if shape else ()
        found = _with_statistics(specification, cell, figures[cell.number])
        for name, figure in table.items():
            part = _placed(found[name], figure.dimensions, cell, states)
            wholes[name][(*place, *(slice(length) for length in part.shape))] = part
    variables: dict[str, Any] = {}
    for name, figure in table.items():
        units = {"score": unit, "state": "as state_unit"}.get(figure.units, figure.units)
        variables[name] = (
            (*fields, *figure.dimensions), wholes[name],
            {"units": units, "long_name": figure.meaning},
        )  # fmt: skip
    used = {dimension for figure in table.values() for dimension in figure.dimensions}
    coordinates = _coordinates(specification, cells, fields, sizes, states)
    return xarray.Dataset(
        variables,
        {name: of for name, of in coordinates.items() if name not in sizes or name in used},
        _provenance(specification, cells),
    )


def table_of(keep: str) -> dict[str, Figure]:
    """Return the variables of a result that keeps this: reduced ones have statistics for runs."""
    swept, names = {name: FIGURES[name] for name in SWEPT}, REDUCED[keep]
    reduced = {
        name: figure._replace(
            dimensions=("statistic", *(d for d in figure.dimensions if d != "run"))
        )
        for name, figure in swept.items()
        if name in names and "run" in figure.dimensions
    }
    paired = {
        name: Figure(("pair_statistic",), "1", RATIOS[name].meaning, _of_moments)
        for name, (one, other) in PAIRS.items()
        if {one, other} <= set(names)
    }
    return swept | reduced | paired


def _of_moments(view: object) -> np.ndarray:
    raise TypeError("a ratio is made of moments")


def _with_statistics(
    specification: Specification, cell: Cell, figures: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the figures of a cell with statistics in the place of moments."""
    names = REDUCED[specification.keep]
    if not names:
        return dict(figures)
    states = len(definition_of(cell.scenario).plant(cell.scenario).state_names)
    sizes = {"step": cell.scenario.steps, "node": cell.scenario.nodes, "state": states}
    shapes = {
        name: tuple(sizes[d] for d in FIGURES[name].dimensions if d != "run") for name in names
    }
    found = statistics_of(figures, shapes)
    rms = STATISTICS.index("rms")
    # A bound is one for all runs: the root of its mean square over the pieces.
    bounds = {name: found[name][rms] for name in names if "run" not in FIGURES[name].dimensions}
    return {**figures, **found, **bounds}


def score_unit(definitions: Sequence[ScenarioDefinition]) -> str:
    """Return the one unit in which the errors of all cells are.

    Raises:
        ValueError: there are several.
    """
    units = sorted({definition.score.unit for definition in definitions})
    if len(units) > 1:
        raise ValueError(
            f"the swept scenarios measure their errors in {' and '.join(units)}, which cannot "
            "stand in one table; sweep them apart"
        )
    return units[0]


def write_result(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a result as netCDF, whole or not at all."""
    write_dataset(dataset, path, compressed=True)


def read_result(path: Path) -> "xarray.Dataset":
    """Return the data set of a finished sweep.

    Raises:
        ValueError: it cannot be read, or is none of ours.
    """
    remedy = "name the file that `concord sweep` has made"
    if not path.is_file():
        there = "is a folder" if path.is_dir() else "does not exist"
        raise ValueError(f"{path} {there}; {remedy}")
    dataset = read_dataset(path, ("rmse",), remedy)
    if SPECIFICATION not in dataset.attrs:
        raise ValueError(f"{path}: not the result of `concord sweep`: it has no specification")
    try:
        specification = specification_of(dataset)
        require_known(specification, path)
        cells_of(specification)
    except UnknownCode:
        raise
    except ValueError as error:
        raise ValueError(f"{path}: is damaged ({error}); {remedy}") from None
    lacking = {"seed", "versions", "commit"} - dataset.attrs.keys()
    if lacking or "units" not in dataset["rmse"].attrs:
        raise ValueError(f"{path}: is damaged (it lacks seed, versions or units); {remedy}")
    return dataset


def specification_of(dataset: "xarray.Dataset") -> Specification:
    """Return the specification of the sweep."""
    return msgspec.json.decode(dataset.attrs[SPECIFICATION], type=Specification)


def dimensions_of(dataset: "xarray.Dataset") -> tuple[str, ...]:
    """Return the dimensions of its cells: the swept fields, or `cell` for a Latin hypercube."""
    return tuple(str(d) for d in dataset["rmse"].dims if d not in ("run", "statistic"))


def flattened(dataset: "xarray.Dataset") -> list[tuple[Cell, "xarray.Dataset"]]:
    """Each cell with its part of the data."""
    dimensions = dimensions_of(dataset)
    cells = cells_of(specification_of(dataset))
    shape = tuple(dataset.sizes[d] for d in dimensions)
    parts = []
    for cell in cells:
        place = np.unravel_index(cell.number, shape) if shape else ()
        parts.append((cell, dataset.isel(dict(zip(dimensions, map(int, place), strict=True)))))
    return parts


# --- parts of the data set -----------------------------------------------------------------------


def _fields(specification: Specification, cells: Sequence[Cell]) -> dict[str, Sequence[Value]]:
    """Return the dimensions of the cells and their values."""
    if specification.samples:
        return {"cell": [cell.number for cell in cells]}
    return dict(specification.levels)


def _states(cells: Sequence[Cell], definitions: Sequence[ScenarioDefinition]) -> dict[str, str]:
    """Names of all states and their units, in order."""
    states: dict[str, str] = {}
    by_name = {
        cell.scenario.name: (definition, cell.scenario)
        for cell, definition in zip(cells, definitions, strict=True)
    }
    for definition, scenario in by_name.values():
        plant = definition.plant(scenario)
        states |= dict(zip(plant.state_names, plant.state_units, strict=True))
    return states


def _placed(
    values: np.ndarray, dimensions: Sequence[str], cell: Cell, states: Mapping[str, str]
) -> np.ndarray:
    """Values of a cell, its states put where the data set has them."""
    if "state" not in dimensions:
        return values
    names = definition_of(cell.scenario).plant(cell.scenario).state_names
    wide = np.full((*values.shape[:-1], len(states)), np.nan)
    wide[..., [list(states).index(name) for name in names]] = values
    return wide


def _coordinates(
    specification: Specification,
    cells: Sequence[Cell],
    fields: Mapping[str, Sequence[Value]],
    sizes: Mapping[str, int],
    states: Mapping[str, str],
) -> dict[str, Any]:
    coordinates: dict[str, Any] = {
        **{field: _plain(values) for field, values in fields.items()},
        "run": np.arange(sizes["run"]),
        "step": np.arange(sizes["step"]),
        "node": np.arange(sizes["node"]),
        "state": list(states),
        "state_unit": ("state", list(states.values())),
        "statistic": list(STATISTICS),
        "pair_statistic": list(PAIR_STATISTICS),
    }
    if specification.samples:
        coordinates |= {
            field: ("cell", _plain([cell.values[field] for cell in cells]))
            for field in specification.dimensions
        }
    plants = {cell.scenario.name: cell.scenario for cell in cells}.values()
    lengths = {definition_of(one).plant(one).time_step_s for one in plants}
    if len(lengths) == 1:
        coordinates["time"] = ("step", np.arange(sizes["step"]) * lengths.pop(), {"units": "s"})
    return coordinates


def _plain(values: Sequence[Value]) -> list[Any]:
    """Values as netCDF can hold them: numbers, or text."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return list(values)
    return [str(value) for value in values]


def _provenance(specification: Specification, cells: Sequence[Cell]) -> dict[str, Any]:
    return {
        "title": f"concord sweep of {', '.join(specification.dimensions) or 'one cell'}",
        SPECIFICATION: msgspec.json.encode(specification).decode(),
        "seed": cells[0].scenario.seed if "seed" not in specification.dimensions else "swept",
        **provenance(),
    }
