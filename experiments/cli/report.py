"""`concord report`: a result as one page with its tables, pictures, seeds and versions."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
import tyro

from concord.experiments.cli.plot import figures_of, result_of
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.figures.intervals import Interval
from concord.results.palette import use_house_style
from concord.results.report_page import (
    Code,
    Grid,
    Heading,
    PagePart,
    Paragraph,
    as_html,
    as_latex,
    as_markdown,
    picture,
)
from concord.scenarios.user.trust import trust
from concord.studies.sweep.specification import shown
from concord.topology.names import unknown_name

if TYPE_CHECKING:
    import xarray

    from concord.results.folder import Description


@dataclass(frozen=True)
class ReportOptions:
    """Of what, and where to."""

    result: tyro.conf.Positional[Path]
    """Result of `concord sweep` or `concord design`, or folder of a run or its run.nc."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The page: .html, .md, or .tex for its tables alone (booktabs); beside the result when left
    out. An older one is replaced."""
    columns: str | None = None
    """Figures of a sweep in its table, such as rmse,anees,bytes_per_step; all that are known when
    left out."""
    json: bool = False
    """Print one JSON object instead of a line."""
    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def report(options: Annotated[ReportOptions, tyro.conf.arg(name="")]) -> None:
    """Write a result as one self-contained page."""
    use_house_style()
    with user_errors():
        trust(options.trust)
        result = result_of(options.result)
        out = options.out or (
            result / "report.html" if result.is_dir() else result.with_suffix(".html")
        )
        if out.suffix not in _FORMS:
            raise ValueError(f"--out {out}: must end in {', '.join(_FORMS)}")
        title, parts = page_of(result, options.columns, pictures=out.suffix != ".tex")
        text = _FORMS[out.suffix](title, parts)
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            part = out.with_name(f"{out.name}.part")
            part.write_text(text, encoding="utf-8")
            part.replace(out)
        except OSError as error:
            raise ValueError(f"--out {out}: cannot be written ({error.strerror})") from None
    if options.json:
        sys.stdout.write(msgspec.json.encode({"page": str(out)}).decode() + "\n")
        return
    plain_console().print(str(out), soft_wrap=True)


def page_of(
    result: Path, columns: str | None = None, pictures: bool = True
) -> tuple[str, list[PagePart]]:
    """Title and parts of the page of a result; `columns` are the figures of a sweep's table.

    Raises:
        ValueError: it is no result of ours, or has no such figure.
    """
    figures = figures_of(result) if pictures else {}
    if result.is_dir():
        title, parts = _of_run(result)
    elif result.suffix == ".json":
        title, parts = _of_design(result)
    else:
        title, parts = _of_sweep(result, columns)
    drawn: list[PagePart] = [Heading("Pictures")] if pictures else []
    drawn += [picture(name, figure) for name, figure in figures.items()]
    return title, [Heading(title, 1), *parts[:-2], *drawn, *parts[-2:]]


def _of_sweep(path: Path, chosen: str | None) -> tuple[str, list[PagePart]]:
    from concord.studies.sweep.results import read_result, specification_of
    from concord.studies.sweep.summary import figures_of as summary_of

    dataset = read_result(path)
    summary = summary_of(dataset)
    fields = specification_of(dataset).dimensions
    units = {"rmse": f" [{summary.unit}]", "disagreement": f" [{summary.unit}]"}
    names = list(summary.cells[0].figures)
    known = [n for n in names if not all(np.isnan(cell[n].value) for cell in summary.cells)]
    columns = known if chosen is None else [name.strip() for name in chosen.split(",")]
    for name in columns:
        if name not in names:
            raise unknown_name("figure of --columns", name, names)
    rows = [
        [
            *(shown(cell.cell[field]) for field in fields),
            cell.level,
            *(_interval(cell[name]) for name in columns),
        ]
        for cell in summary.cells
    ]
    head = [
        *fields,
        "level",
        *(f"{name.replace('_', ' ')}{units.get(name, '')}" for name in columns),
    ]
    return f"Sweep of {', '.join(fields) or 'one cell'}", [
        Paragraph(
            f"{len(summary.cells)} cells of {summary.runs} runs each, seed {summary.seed}. Each "
            "figure has its 95 % interval over the runs, which have the same noise in "
            "every cell of one seed. docs/sweeps.md says what each figure is."
        ),
        Grid(head, rows, len(fields) + 1),
        *_provenance(_attributes(dataset), dataset.attrs["specification"]),
    ]


def _attributes(dataset: "xarray.Dataset") -> dict[str, str]:
    versions = json.loads(dataset.attrs["versions"])
    return {"commit": str(dataset.attrs["commit"]), **versions}


def _of_design(path: Path) -> tuple[str, list[PagePart]]:
    from concord.experiments.cli.design import lines
    from concord.studies.design.candidates import COSTS
    from concord.studies.design.results import read_design

    design = read_design(path)
    unit = design.unit if design.target.reference == "unit" else f"x {design.target.reference}"
    line = sorted((one for one in design.tried if one.front), key=lambda one: -one.error.value)
    fields = list(line[0].values)
    rows = [
        [
            *(shown(one.values[field]) for field in fields),
            _interval(one.error),
            _interval(one.anees),
            *(f"{one.costs[cost]:.4g}" for cost in COSTS),
            str(one.runs),
        ]
        for one in line
    ]
    headings = [figure.heading for figure in COSTS.values()]
    head = [*fields, f"RMSE {unit}", "ANEES", *headings, "runs"]
    names = ("scenario", "settled", "seed", "target", "minimise")
    wanted = {name: msgspec.to_builtins(getattr(design, name)) for name in names}
    return f"Design for {design.target.shown(design.unit)}", [
        *(Paragraph(text) for text in lines(design)),
        Heading("Front"),
        Paragraph(f"What none of {len(design.tried)} candidates beats in cost and error."),
        Grid(head, rows, len(fields)),
        *_provenance({"commit": str(design.commit), **design.versions}, json.dumps(wanted)),
    ]


def _of_run(folder: Path) -> tuple[str, list[PagePart]]:
    from concord.experiments.cli.collect import trace_with_progress
    from concord.results.figures.summary import summarise
    from concord.results.figures.summary_table import lines
    from concord.results.folder import BATCHED, WITHOUT_CODE, read_shown
    from concord.results.records.netcdf_file import ARRAYS
    from concord.results.records.runs import runs_of_trace
    from concord.results.records.runs_file import read_runs
    from concord.results.run_results import as_it_ran
    from concord.scenarios.catalogue import is_received

    description = read_shown(folder)
    if is_received(description.setup.scenario):
        sys.stderr.write(WITHOUT_CODE.format(folder=folder))
    if description.driver == BATCHED:
        figures = summarise(*read_runs(folder / ARRAYS, description.setup))
    else:
        trace = trace_with_progress(folder, description, False)
        figures = summarise(runs_of_trace(as_it_ran(description, trace).setup, trace))
    several = "Run" if figures.runs == 1 else f"{figures.runs} runs"
    unit = figures.unit
    names = ("rmse", "rmse_alone", "anees", "sent", "heard", "missed")
    rows = [
        [str(i), *(_interval(node[name]) for name in names)] for i, node in enumerate(figures.nodes)
    ]
    totals = ("rmse", "rmse_alone", "anees", "shares_sent", "", "shares_missed")
    whole = [_interval(figures.figures[name]) if name else "" for name in totals]
    head = ["node", f"RMSE [{unit}]", f"alone [{unit}]", "ANEES", "sent", "heard", "missed"]
    scenario = msgspec.json.encode(description.setup.scenario).decode()
    return f"{several} {description.run}", [
        Paragraph(f"Driver {description.driver}, seed {description.seed}."),
        Paragraph(figures.verdict.in_words()),
        *(Paragraph(one.in_words()) for one in figures.outages),
        *(Paragraph(text) for text in lines(figures)),
        Paragraph(f"States: {_states(description)}."),
        Grid(head, [*rows, ["all", *whole]], 1),
        *_provenance({"commit": str(description.commit), **description.versions}, scenario),
    ]


def _states(description: "Description") -> str:
    found = description.states
    pairs = [] if found is None else zip(found.names, found.units, strict=True)
    return ", ".join(f"{name} [{unit}]" for name, unit in pairs) or "run.json does not name them"


def _provenance(versions: Mapping[str, str], what: str) -> Sequence[PagePart]:
    """Always two parts: what computed, and what exactly was asked for."""
    said = ", ".join(f"{name} {version}" for name, version in versions.items())
    return [Paragraph(f"Computed by {said}."), Code(json.dumps(json.loads(what), indent=2))]


def _interval(interval: Interval) -> str:
    if np.isnan(interval.value):
        return "-"
    return f"{interval.value:.4g} {interval.spread()}".rstrip()


_FORMS: dict[str, Callable[[str, list[PagePart]], str]] = {
    ".html": as_html,
    ".md": lambda _, parts: as_markdown(parts),
    ".tex": lambda _, parts: as_latex(parts),
}
"""The page as text, by the ending of its file."""
