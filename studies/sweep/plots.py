"""Pictures of a sweep: error over time, error against what it costs, heat maps, fronts."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import stdtrit

from concord.results.figures.intervals import Interval
from concord.results.network_map import Mapped, network_maps
from concord.results.palette import (
    GREY,
    SEQUENTIAL,
    name_styles,
    plain_numbers,
    styles,
)
from concord.scenarios.preparation import prepare
from concord.studies.monte_carlo.pareto import front
from concord.studies.sweep.cell_data import CellData
from concord.studies.sweep.plot_layout import (
    CellResult,
    Layout,
    drawn,
    grouped,
    layout_of,
    levels_of,
    subtitle,
)
from concord.studies.sweep.results import flattened
from concord.studies.sweep.specification import named, shown

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray
    from matplotlib.figure import Figure

    from concord.studies.sweep.cells import Cell

PANEL_WIDTH, PANEL_HEIGHT = 3.1, 2.7
MOST_PANELS = 4
TO_CENTRALISED = "RMSE, x centralised"


def error_over_time(dataset: "xarray.Dataset") -> "Figure | None":
    """Network error at each step with its band over runs: a panel per graph and level."""
    layout = layout_of(dataset)
    parts = flattened(dataset)
    rows, columns = _rows_and_columns(dataset, layout)
    rest = Layout(layout.colour, None, None, layout.rest)
    parts = drawn(parts, rest)
    figure, grid = _panels(len(rows), len(columns), sharex=True, sharey=True)
    look = styles(_names(dataset, layout.colour))
    for axes, row, column in _each(grid, rows, columns):
        here = [
            part for part in parts
            if _is(part, layout.axis, row) and _is(part, layout.panel, column)
        ]  # fmt: skip
        _draw_errors(axes, here, layout, look)
        axes.set_title(_title({layout.panel: column, layout.axis: row}), loc="left")
    unit = dataset["rmse"].attrs["units"]
    for axes in grid[-1]:
        axes.set_xlabel("time [s]" if "time" in dataset.coords else "step")
    for axes in grid[:, 0]:
        axes.set_ylabel(f"error [{unit}]")
    _legend(figure, grid)
    figure.suptitle(f"Error over time; band: 95 % of the mean over runs\n{subtitle(dataset, rest)}",
                    fontsize=9, x=0.01, ha="left")  # fmt: skip
    return figure


def error_against_axis(dataset: "xarray.Dataset") -> "Figure | None":
    """Error relative to the centralised filter against a swept number, a line per rule."""
    layout = layout_of(dataset)
    if layout.axis is None or len(levels_of(dataset)[layout.axis]) < 2:
        return None
    parts = drawn(flattened(dataset), layout)
    panels = _limited(_names(dataset, layout.panel))
    figure, grid = _panels(1, len(panels), sharey=True)
    look = styles(_names(dataset, layout.colour))
    for axes, _, panel in _each(grid, [None], panels):
        here = [part for part in parts if _is(part, layout.panel, panel)]
        for name, line in grouped(here, layout.colour).items():
            _draw_line(axes, line, layout.axis, name, look[name])
        axes.axhline(1, color=GREY, linewidth=1, linestyle="--")
        _tick_at_levels(axes, levels_of(dataset)[layout.axis])
        axes.set_xlabel(layout.axis)
        axes.set_title(_title({layout.panel: panel}), loc="left")
    _log_if_wide(grid, np.array([_ratio(data).value for _, data in parts]))
    grid[0, 0].set_ylabel(TO_CENTRALISED)
    _legend(figure, grid)
    figure.suptitle(f"Error against {layout.axis}; bars: 95 % interval over paired runs\n"
                    f"{subtitle(dataset, layout)}", fontsize=9, x=0.01, ha="left")  # fmt: skip
    return figure


def heat_map(dataset: "xarray.Dataset") -> "Figure | None":
    """Error relative to the centralised filter over two swept fields, in numbers and colour."""
    layout = layout_of(dataset)
    levels = levels_of(dataset)
    down = layout.colour
    across = layout.axis or layout.panel
    if down is None or across is None or any(len(levels[f]) > 12 for f in (down, across)):
        return None
    panel = layout.panel if across != layout.panel else None
    parts = drawn(flattened(dataset), layout)
    panels = _limited(_names(dataset, panel))
    figure, grid = _panels(1, len(panels), height=0.9 + 0.42 * len(levels[down]))
    values = [
        _matrix(
            [p for p in parts if _is(p, panel, one)], levels[down], levels[across], down, across
        )
        for one in panels
    ]
    low, high = np.nanmin(values), np.nanmax(values)
    image = None
    for (axes, _, one), matrix in zip(_each(grid, [None], panels), values, strict=True):
        image = axes.imshow(np.log10(matrix), cmap=f"{SEQUENTIAL}_r", aspect="auto",
                            vmin=np.log10(low), vmax=np.log10(max(high, low * 1.01)))  # fmt: skip
        _write_numbers(axes, matrix, low, high)
        axes.set_xticks(range(len(levels[across])), [shown(v) for v in levels[across]])
        axes.set_yticks(range(len(levels[down])), [shown(v) for v in levels[down]])
        axes.set_xlabel(across)
        axes.set_title(_title({panel: one}), loc="left")
        axes.grid(visible=False)
    figure.suptitle(f"{TO_CENTRALISED}; dark is worse\n{subtitle(dataset, layout)}",
                    fontsize=9, x=0.01, ha="left")  # fmt: skip
    return figure if image is not None else None


def _cost(
    dataset: "xarray.Dataset", parts: "Sequence[tuple[Cell, xarray.Dataset]]"
) -> tuple[np.ndarray, str]:
    """Return the cost of each cell, and what it is."""
    times, sizes = (
        [CellData(data).mean(name).value for _, data in parts]
        for name in ("bus_time_us", "bytes_per_step")
    )
    if "bus" in dataset.dims and not np.isnan(times).any():
        # Sums of decimals differ in the last bits: equal to the nanosecond is equal.
        return np.round(times, 3), "microseconds of the bus per step, all nodes"
    return np.array(sizes), "bytes on the bus per step, all nodes"


def pareto(dataset: "xarray.Dataset") -> "Figure | None":
    """Error against cost: each cell a mark, the front a line.

    The cost is bytes on the bus, or microseconds where the cells have several buses with time: a
    byte lasts longer on a slower bus.
    """
    parts = flattened(dataset)
    cost, label = _cost(dataset, parts)
    intervals = np.array([_ratio(data) for _, data in parts])
    ratio = intervals[:, 0]
    known = ~np.isnan(cost) & ~np.isnan(ratio)
    if known.sum() < 2:
        return None
    layout = layout_of(dataset)
    figure, grid = _panels(1, 1, width=6.6, height=4.2)
    axes = grid[0, 0]
    colours = styles(_names(dataset, layout.colour))
    shapes = styles(_names(dataset, layout.panel))
    for (cell, _), x, y, bar in zip(parts, cost, ratio, _bars(intervals).T, strict=True):
        colour = colours[_name(cell.values, layout.colour)].colour
        marker = shapes[_name(cell.values, layout.panel)].marker
        axes.errorbar(x, y, yerr=bar[:, None], marker=marker, color=colour, markersize=5, alpha=0.8,
                      capsize=2, linewidth=1)  # fmt: skip
    best = front(cost, ratio)
    axes.step(cost[best], ratio[best], where="post", color=GREY, linewidth=1, zorder=0)
    middle = np.sqrt(np.nanmin(cost) * np.nanmax(cost))
    for place in best[: 2 * MOST_PANELS]:
        right = cost[place] > middle
        name = ", ".join(map(shown, parts[place][0].values.values()))
        axes.annotate(name, (cost[place], ratio[place]), fontsize=6.5,
                      xytext=(-6 if right else 6, -10 if right else 5),
                      textcoords="offset points", ha="right" if right else "left")  # fmt: skip
    axes.set(xlabel=label, ylabel=TO_CENTRALISED, xscale="log")
    plain_numbers(axes.xaxis)
    _log_if_wide(grid, ratio)
    name_styles(axes, colours, shapes)
    _legend(figure, grid)
    figure.suptitle("What error costs; bars: 95 % interval; the line joins cells that none beats\n"
                    f"{subtitle(dataset, layout._replace(rest=()))}", fontsize=9, x=0.01,
                    ha="left")  # fmt: skip
    return figure


def network_map(dataset: "xarray.Dataset") -> "Figure | None":
    """Return the best cell of each panel as a map of its nodes' errors."""
    layout = layout_of(dataset)
    best: list[Mapped] = []
    for name, parts in grouped(flattened(dataset), layout.panel).items():
        known = [part for part in parts if not np.isnan(_ratio(part[1]).value)]
        if not known or len(best) == MOST_PANELS:
            continue
        cell, data = min(known, key=lambda part: _ratio(part[1]).value)
        setup = prepare(cell.scenario)
        error = CellData(data).rms("rmse_node")
        inside = {field: value for field, value in cell.values.items() if field != layout.panel}
        head = [f"{layout.panel}={name}"] if layout.panel else []
        title = ", ".join([*head, *([named(inside)] if inside else [])])
        best.append(Mapped(setup, error[: cell.scenario.nodes], title))
    if not best:
        return None
    figure = network_maps(best, dataset["rmse"].attrs["units"])
    figure.suptitle(f"Error of each node, in the best cell of each\n"
                    f"{subtitle(dataset, layout._replace(rest=()))}", fontsize=9, x=0.01,
                    ha="left")  # fmt: skip
    return figure


def sweep_figures(dataset: "xarray.Dataset") -> "dict[str, Figure]":
    """Return the pictures that a result has enough for, by name."""
    made = {
        "error-over-time": error_over_time,
        "error-against": error_against_axis,
        "heat-map": heat_map,
        "pareto": pareto,
        "network-map": network_map,
    }
    drawn_ = {name: make(dataset) for name, make in made.items()}
    return {name: figure for name, figure in drawn_.items() if figure is not None}


# --- parts of pictures ---------------------------------------------------------------------------


def _draw_errors(axes: Any, parts: list[CellResult], layout: Layout, look: dict[str, Any]) -> None:
    for name, line in grouped(parts, layout.colour).items():
        _, data = line[0]
        x = data["time"].to_numpy() if "time" in data.coords else data["step"].to_numpy()
        middle, (runs, spread) = CellData(data).rms("error"), CellData(data).spread("error")
        style = look[name]
        axes.plot(x, middle, color=style.colour, linestyle=style.dash, label=name or "network")
        if np.nanmax(runs) > 1:
            # The interval of the logarithm: it cannot fall below zero.
            grown = np.exp(0.5 * stdtrit(runs - 1, 0.975) * spread / np.sqrt(runs))
            axes.fill_between(x, middle / grown, middle * grown, color=style.colour, alpha=0.18,
                              linewidth=0)  # fmt: skip
    if parts:
        _, data = parts[0]
        x = data["time"].to_numpy() if "time" in data.coords else data["step"].to_numpy()
        central = CellData(data).rms("error_centralised")
        axes.plot(x, central, color="black", linewidth=1, label="centralised")
        axes.plot(x, data["bound"].to_numpy(), color=GREY, linewidth=1, linestyle=":",
                  label="Cramér-Rao bound")  # fmt: skip
    axes.set_yscale("log")
    plain_numbers(axes.yaxis)


def _draw_line(axes: Any, line: list[CellResult], axis: str, name: str, style: Any) -> None:
    points = sorted((float(cell.values[axis]), _ratio(data)) for cell, data in line)  # type: ignore[arg-type]
    x = np.array([place for place, _ in points])
    y = np.array([ratio for _, ratio in points])
    axes.errorbar(x, y[:, 0], yerr=_bars(y), color=style.colour, marker=style.marker,
                  linestyle=style.dash, capsize=2.5, label=name or "network")  # fmt: skip


def _bars(intervals: np.ndarray) -> np.ndarray:
    """Return how far intervals (n, 3) of value, low, high reach down and up (2, n)."""
    return np.nan_to_num(np.abs(intervals[:, 1:] - intervals[:, :1]).T)


def _ratio(data: "xarray.Dataset") -> Interval:
    return CellData(data).ratio("rmse", "rmse_centralised")


def _matrix(parts: list[CellResult], rows: Any, columns: Any, down: str, across: str) -> np.ndarray:
    matrix = np.full((len(rows), len(columns)), np.nan)
    for cell, data in parts:
        place = rows.index(cell.values[down]), columns.index(cell.values[across])
        matrix[place] = _ratio(data).value
    return matrix


def _write_numbers(axes: Any, matrix: np.ndarray, low: float, high: float) -> None:
    middle = np.sqrt(low * high)
    for (row, column), value in np.ndenumerate(matrix):
        if np.isfinite(value):
            axes.text(column, row, f"{value:.3g}", ha="center", va="center", fontsize=8,
                      color="white" if value > middle else "black")  # fmt: skip


def _rows_and_columns(dataset: "xarray.Dataset", layout: Layout) -> tuple[list[Any], list[Any]]:
    columns, rows = (_limited(_names(dataset, field)) for field in (layout.panel, layout.axis))
    return rows, columns


def _names(dataset: "xarray.Dataset", field: str | None) -> list[str]:
    """Return the values of a field as text; one empty name without a field."""
    return [""] if field is None else [shown(value) for value in levels_of(dataset)[field]]


def _name(values: Any, field: str | None) -> str:
    return "" if field is None else shown(values[field])


def _limited(names: list[str]) -> list[str]:
    """At most so many panels, spread over the values."""
    if len(names) <= MOST_PANELS:
        return names
    places = np.linspace(0, len(names) - 1, MOST_PANELS).round().astype(int)
    return [names[place] for place in places]


def _is(part: CellResult, field: str | None, name: str | None) -> bool:
    return field is None or not name or shown(part[0].values[field]) == name


def _title(values: dict[str | None, str | None]) -> str:
    return ", ".join(f"{field} {value}" for field, value in values.items() if field and value)


def _panels(rows: int, columns: int, *, width: float = PANEL_WIDTH, height: float = PANEL_HEIGHT,
            **shared: Any) -> tuple[Any, Any]:  # fmt: skip
    import matplotlib.pyplot as plt

    # A single panel is given the width that its title needs.
    wide = max(width * columns, 6.0)
    return plt.subplots(
        rows, columns, figsize=(wide, height * rows + 1.1), squeeze=False, layout="constrained",
        **shared,
    )  # type: ignore[return-value]  # fmt: skip


def _each(grid: Any, rows: list[Any], columns: list[Any]) -> list[tuple[Any, Any, Any]]:
    return [
        (grid[r, c], row, column) for r, row in enumerate(rows) for c, column in enumerate(columns)
    ]


def _tick_at_levels(axes: Any, levels: list[Any]) -> None:
    """Ticks at the values that were swept, unless they would run into each other."""
    if len(levels) <= 8:
        places = sorted(float(level) for level in levels)
        axes.set_xticks(places, [f"{place:g}" for place in places])


def _log_if_wide(grid: Any, values: np.ndarray) -> None:
    if np.nanmax(values) > 5 * np.nanmin(values):
        for axes in grid.flat:
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)


def _legend(figure: Any, grid: Any) -> None:
    handles: dict[str, Any] = {}
    for axes in grid.flat:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if len(handles) > 1:
        figure.legend(handles.values(), handles.keys(), loc="outside lower center",
                      ncols=min(len(handles), 6))  # fmt: skip
