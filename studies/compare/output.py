"""The files of a comparison: a page, a data set, JSON, Markdown and LaTeX tables in a folder."""

from pathlib import Path
from typing import TYPE_CHECKING

from concord.disk import whole_file
from concord.results.places import make_folder
from concord.results.records.netcdf_file import write_dataset
from concord.results.report_page import as_html, as_markdown
from concord.studies.compare.results import ComparisonFigures
from concord.studies.compare.tables import as_json, latex, overviews, page

if TYPE_CHECKING:
    import xarray

RESULTS = "results.nc"


def write_comparison(dataset: "xarray.Dataset", figures: ComparisonFigures, folder: Path) -> None:
    """Write report.html, results.nc, table.tex, table.md and compare.json."""
    parts = page(figures)
    make_folder(folder, "--out")
    write_dataset(dataset, folder / RESULTS)
    texts = {
        "report.html": as_html("Comparison of fusion rules", parts),
        "table.tex": latex(figures),
        "table.md": as_markdown(overviews(figures)),
        "compare.json": as_json(figures).decode() + "\n",
    }
    for name, text in texts.items():
        with whole_file(folder / name) as part:
            part.write_text(text, encoding="utf-8")
