"""`concord plot`: pictures of the result of a sweep, of a design, or of a run folder."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro
from rich.console import Console

from concord.experiments.user_errors import user_errors
from concord.results.palette import save, use_house_style
from concord.results.places import make_folder
from concord.results.records.netcdf_file import ARRAYS, DESCRIPTION

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class PlotOptions:
    """Picture to draw, and its file."""

    result: tyro.conf.Positional[Path]
    """Result of `concord sweep` or `concord design`, or folder of a run or its run.nc."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the pictures; beside the result, <name>-plots, when left out."""
    format: Literal["png", "svg", "pdf"] = "png"
    """Format of the pictures."""
    json: bool = False
    """Print one JSON object instead of lines."""


def plot(options: Annotated[PlotOptions, tyro.conf.arg(name="")]) -> None:
    """Draw a result."""
    use_house_style()
    with user_errors():
        result = result_of(options.result)
        figures = figures_of(result)
        folder = options.out or plots_of(result)
        make_folder(folder, "--out")
    written = []
    for name, figure in figures.items():
        path = folder / f"{name}.{options.format}"
        save(figure, path)
        written.append(str(path))
    if options.json:
        sys.stdout.write(msgspec.json.encode({"pictures": written}).decode() + "\n")
        return
    Console().print("\n".join(written), highlight=False, soft_wrap=True)


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
