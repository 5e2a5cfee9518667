"""Figures of a report, saved as PNG and as SVG, and the numbers behind them as one netCDF file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from concord.results.records.netcdf_file import Arrays, write_arrays

# Okabe and Ito's colours, which most people can tell apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#999999"


def save(figure: Figure, folder: Path, name: str, dpi: int = 150) -> str:
    """Write `name`.png and `name`.svg; returns the name of the PNG."""
    # Fixed identifiers and no date: the same figures give the same bytes.
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", dpi=dpi)
    return f"{name}.png"


def save_all(figures: Mapping[str, Figure], folder: Path, first: int) -> str:
    """Write figures by caption as figure-`first` and so on; returns their Markdown."""
    return "\n\n".join(
        shown(caption, save(figure, folder, f"figure-{number}"))
        for number, (caption, figure) in enumerate(figures.items(), start=first)
    )


def shown(caption: str, file: str) -> str:
    """The Markdown of one figure with its caption below."""
    return f"![{caption}]({file})\n\n*{caption.rstrip('.')}.*"


def legend_below(figure: Figure, *sources: Axes, **style: Any) -> None:
    """Draw one legend for the whole figure, with each label of the sources once."""
    found = {}
    for axes in sources:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    place = {"loc": "outside lower center", "frameon": False, "ncols": len(found), **style}
    figure.legend(list(found.values()), list(found), **place)


def one_axes(height_inches: float, width_inches: float = 7.5) -> tuple[Figure, Axes]:
    """A figure with one pair of axes, open above and to the right."""
    figure = Figure(figsize=(width_inches, height_inches), layout="constrained")
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


TRACES = "traces.nc"


def write_traces(
    folder: Path,
    variables: Mapping[str, tuple[Sequence[str], np.ndarray]],
    coordinates: Mapping[str, Sequence[str] | np.ndarray],
) -> None:
    """Write the variables, each with the names of its axes, to `traces.nc` in the folder.

    Args:
        folder: of the report.
        variables: by name, (axes, values).
        coordinates: labels along an axis, by axis.

    Raises:
        NotWritten: the disk does not take it.
    """
    labelled = {axis: list(labels) for axis, labels in coordinates.items()}
    write_arrays(Arrays(variables, labelled, {}), folder / TRACES)
