"""`concord plot`: pictures of the result of a sweep, of a design, or of a run folder."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro

from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.palette import fit_width, save, use_house_style, without_title
from concord.results.places import make_folder
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION
from concord.scenarios.user.trust import trust

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS_OF_AN_INCH = {"mm": 25.4, "cm": 2.54, "in": 1.0, "pt": 72.0}
_PRINTED_DPI = 300


@dataclass(frozen=True)
class PlotOptions:
    """Picture to draw, and its file."""

    result: tyro.conf.Positional[Path]
    """Result of `concord sweep` or `concord design`, or folder of a run or its run.nc."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the pictures; beside the result, <name>-plots, when left out."""
    format: Literal["png", "svg", "pdf"] = "png"
    """Format of the pictures."""
    width: str | None = None
    """Width of the pictures on paper, such as 88mm or 3.5in; what they need when left out."""
    title: bool = True
    """Leave out what stands above the pictures, for a caption below them."""
    json: bool = False
    """Print one JSON object instead of lines."""
    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def plot(options: Annotated[PlotOptions, tyro.conf.arg(name="")]) -> None:
    """Draw a result."""
    with user_errors():
        trust(options.trust)
        width = None if options.width is None else _inches(options.width)
        use_house_style(*(() if width is None else (_PRINTED_DPI,)))
        result = result_of(options.result)
        figures = figures_of(result)
        folder = options.out or plots_of(result)
        make_folder(folder, "--out")
    written = []
    for name, figure in figures.items():
        path = folder / f"{name}.{options.format}"
        if not options.title:
            without_title(figure)
        if width is not None:
            fit_width(figure, width)
        save(figure, path)
        written.append(str(path))
    if options.json:
        sys.stdout.write(msgspec.json.encode({"pictures": written}).decode() + "\n")
        return
    plain_console().print("\n".join(written), soft_wrap=True)


def _inches(text: str) -> float:
    """Return a width as inches.

    Raises:
        ValueError: it is none.
    """
    found = re.fullmatch(r"(\d+\.?\d*)(mm|cm|in|pt)", text)
    if found is None or float(found[1]) == 0:
        raise ValueError(
            f"--width {text}: must be a number above 0 with its unit (mm, cm, in or pt), such as "
            "88mm"
        )
    return float(found[1]) / _UNITS_OF_AN_INCH[found[2]]


def result_of(named: Path) -> Path:
    """Return the result that a user names: run.nc stands for the folder of its run.

    Raises:
        ValueError: there is none.
    """
    if not named.exists():
        raise ValueError(
            f"{named} does not exist; name the folder of a run, or the file that `concord sweep` "
            "or `concord design` has made"
        )
    of_run = named.name == ARRAYS and (named.parent / DESCRIPTION).is_file()
    return named.parent if of_run else named


def plots_of(result: Path) -> Path:
    """Where the pictures of a result go."""
    return result / "plots" if result.is_dir() else result.with_name(f"{result.stem}-plots")


def figures_of(result: Path) -> "dict[str, Figure]":
    """Return the pictures of a result by name.

    Raises:
        ValueError: it is no result of ours.
    """
    if result.is_dir():
        from concord.results.run_plots import run_figures

        return run_figures(result)
    if result.suffix == ".json":
        from concord.studies.design.plots import design_figures
        from concord.studies.design.results import read_design

        return design_figures(read_design(result))
    from concord.studies.sweep.plots import sweep_figures
    from concord.studies.sweep.results import read_result

    return sweep_figures(read_result(result))
