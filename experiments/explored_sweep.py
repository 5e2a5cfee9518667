"""A sweep for its page: figures of its cells, and pages of runs that are computed on demand."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from concord.dashboard.sweeps.swept import CellQuantity, SweptCells
from concord.experiments.page_options import PageOptions
from concord.results.figures.intervals import ratio_t
from concord.results.folder import (
    describe,
    read_description,
    read_description_file,
    write_description,
)
from concord.results.records.netcdf_file import DESCRIPTION, RECORDING
from concord.runtime.drivers import in_this_process
from concord.scenarios.preparation import prepare
from concord.studies.sweep.cell_data import CellData
from concord.studies.sweep.plot_layout import layout_of
from concord.studies.sweep.results import flattened, specification_of
from concord.studies.sweep.specification import Cell, shown
from concord.studies.sweep.summary import figures_of

if TYPE_CHECKING:
    import xarray

    from concord.dashboard.app import Dashboard

_LEAST_PAIRS = 2
UP = "RMSE, × centralised"
"""The figure that the page shows at first."""
_FIGURES: tuple[tuple[str, str, float | None], ...] = (
    ("bytes a step [B]", "bytes_per_step", None),
    (UP, "to_centralised", 1.0),
    ("RMSE [{unit}]", "rmse", None),
    ("RMSE, × bound", "to_bound", 1.0),
    ("RMSE of the worst node, × centralised", "worst_node_to_centralised", 1.0),
    ("RMSE of blind nodes, × centralised", "blind_to_centralised", 1.0),
    ("disagreement [{unit}]", "disagreement", None),
    ("ANEES", "anees", 1.0),
    ("coverage", "coverage", 0.95),
    ("bus load", "bus_load", None),
    ("delay [µs]", "delay_us", None),
    ("age of shares [cycles]", "share_age", None),
    ("energy a step [mJ]", "energy_per_step", None),
    ("settling [steps]", "settling_steps", None),
)


def swept_of(dataset: "xarray.Dataset", name: str) -> SweptCells:
    """Return the result of a sweep as its page shows it."""
    specification, parts = specification_of(dataset), flattened(dataset)
    figures = figures_of(dataset)
    quantities = tuple(
        CellQuantity(heading.format(unit=figures.unit), intervals, reference)
        for heading, field, reference in _FIGURES
        for intervals in [np.array([cell[field] for cell in figures.cells], dtype=np.float64)]
        if np.isfinite(intervals[:, 0]).any()
    )
    runs = np.arange(specification.runs)
    data = [CellData(part) for _, part in parts]
    rmse = np.array([
        one.values("rmse") if one.has_runs("rmse") else np.full(len(runs), np.nan) for one in data
    ])  # fmt: skip
    quantities += _beside_best(rmse)
    errors = {
        "nodes": np.array([one.rms("error") for one in data]),
        "centralised": np.array([one.rms("error_centralised") for one in data]),
        "bound": np.array([one.values("bound") for one in data]),
    }
    steps = np.arange(errors["nodes"].shape[1])
    base = ", ".join(f"{field}={shown(value)}" for field, value in specification.base.items())
    return SweptCells(
        title=f"{name}: {len(parts)} cells of {len(runs)} runs; {base or 'defaults'}",
        unit=figures.unit,
        fields={
            field: [cell.values[field] for cell, _ in parts] for field in specification.dimensions
        },
        quantities=quantities,
        colour=layout_of(dataset).colour or "",
        runs=runs,
        rmse=rmse,
        times=dataset["time"].to_numpy() if "time" in dataset.coords else steps,
        errors=errors,
    )


def _beside_best(rmse: np.ndarray) -> tuple[CellQuantity, ...]:
    """Return the RMSE of each cell (C, R) over that of the best, in pairs of equal noise."""
    if not np.isfinite(rmse).all() or rmse.shape[1] < _LEAST_PAIRS or len(rmse) < _LEAST_PAIRS:
        return ()
    squares = rmse**2
    best = squares[np.argmin(squares.mean(1))]
    intervals = [ratio_t(cell, best) for cell in squares]
    return (CellQuantity("RMSE, × best, paired", np.array(intervals), 1.0),)


class RunPages:
    """Runs of a sweep's cells, computed when they are asked for and kept in folders, and their
    pages, each with a thread."""

    def __init__(self, dataset: "xarray.Dataset", result: Path, options: PageOptions) -> None:
        self._cells: list[Cell] = [cell for cell, _ in flattened(dataset)]
        self._folder, self._options = result.with_name(result.name + ".runs"), options
        self._pages: dict[Path, Dashboard] = {}
        self._threads: list[threading.Thread] = []
        self._over = threading.Event()

    def open(self, cell: int, place: int, on_step: Callable[[int], None]) -> str:
        """Return the address of the page of a run, once it is computed.

        Raises:
            ValueError: the run cannot be computed, or another one has its folder.
        """
        from concord.dashboard.serve import open_recording

        folder = self._computed(cell, place, on_step)
        if folder not in self._pages:
            setup, options = read_description(folder).setup, self._options
            # Any free port near that of the sweep: viser takes the next free one.
            port = options.http_port + 1 if options.http_port else 0
            page = open_recording(setup, folder / RECORDING, options.host, port, options.light)
            self._pages[folder] = page
            drawing = threading.Thread(target=page.run, args=(self._over.is_set,), daemon=True)
            self._threads.append(drawing)
            drawing.start()
        return self._pages[folder].url

    def _computed(self, cell: int, run: int, on_step: Callable[[int], None]) -> Path:
        """Return the folder of a run; computes it unless it is there."""
        setup = prepare(self._cells[cell].scenario.with_(run=run))
        folder = self._folder / f"cell-{cell}-run-{run}"
        if folder.exists():
            if read_description_file(folder / DESCRIPTION).setup.scenario != setup.scenario:
                raise ValueError(f"{folder}: holds a run of another sweep; move or remove it")
            return folder
        # A run that is interrupted leaves no folder of its final name.
        begun = folder.with_name(f"{folder.name}.part")
        begun.mkdir(parents=True, exist_ok=True)
        description = describe(folder.name, "in-process", setup)
        write_description(begun, description)
        in_this_process(setup, folder.name, begun / RECORDING, None, on_step)
        return begun.rename(folder)

    def close(self) -> None:
        """End all pages."""
        self._over.set()
        for drawing in self._threads:
            drawing.join()
        for page in self._pages.values():
            page.close()
