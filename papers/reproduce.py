"""`concord reproduce`: a paper's figures and tables, and what became of its claims."""

import sys
import time
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from concord.disk import RunFailed
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.papers.kit.report import (
    REPORT,
    Paper,
    ReproductionReport,
    check_runs,
    held_of,
    report_of,
    write_report,
)
from concord.results.folder import new_folder
from concord.studies.sweep.workers import WorkerLost
from concord.topology.names import unknown_name

NAMES = ("wac", "meng2025", "adlukf", "liu2021")
PAPERS = {name: f"concord.papers.{name}.reproduce" for name in NAMES}


def paper_of(name: str) -> Paper:
    """Return the reproduction of a paper; its modules are imported now.

    Raises:
        ValueError: there is no such paper.
    """
    if name not in PAPERS:
        raise unknown_name("paper", name, PAPERS)
    return import_module(PAPERS[name]).PAPER


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Paper, and folder for the results."""

    paper: Annotated[str, tyro.conf.Positional]
    """wac: Widjiantoro et al., weighted-average-consensus UKF. meng2025: Meng et al., UKF under the
    FlexRay protocol. adlukf: Wang et al., adaptive dual-layer UKF. liu2021: Liu et al., set
    membership over a FlexRay network."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the report and the pictures. It must not exist."""
    seed: int | None = None
    """Seed of all noise; that of the project's published figures if left out."""
    runs: int | None = None
    """Runs of the Monte Carlo; as many as the project's published figures have if left out."""
    json: bool = False
    """Print one JSON object instead of a summary."""


def reproduce(options: Annotated[ReproduceOptions, tyro.conf.arg(name="")]) -> None:
    """Reproduce a paper; exit code 1 if a check fails."""
    with user_errors():
        paper = paper_of(options.paper)
        seed = paper.seed if options.seed is None else options.seed
        runs = paper.runs if options.runs is None else options.runs
        check_runs(paper, runs)
        _, folder = new_folder(options.out, options.paper)
    sys.stderr.write(f"seed {seed}, {runs} runs; results in {folder}\n")
    started = time.monotonic()
    try:
        report = carry_out(options.paper, paper, folder, seed, runs)
    except WorkerLost as error:
        raise RunFailed(f"{error}; finished sections are in {folder}") from error
    sys.stderr.write(f"done in {time.monotonic() - started:.0f} s\n")
    _show(report, folder, options.json)
    if not report.ok:
        sys.exit(1)


def carry_out(name: str, paper: Paper, folder: Path, seed: int, runs: int) -> ReproductionReport:
    """The whole reproduction, section by section on standard error. The report in `folder` is at
    every time as far as the work."""
    done = []
    for section in paper.sections(folder, seed, runs):
        done.append(section)
        sys.stderr.write(f"done: {section.title}\n")
        sys.stderr.flush()
        write_report(report_of(name, seed, runs, done, complete=False), paper.title, folder)
    report = report_of(name, seed, runs, done, complete=True)
    write_report(report, paper.title, folder)
    return report


def _show(report: ReproductionReport, folder: Path, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
        return
    # Only here: it takes a tenth of a second to import.
    from rich.markdown import Markdown

    console = plain_console()
    for section in report.sections:
        if section.shown:
            console.print(Markdown(f"## {section.title}\n\n{section.text}"))
            console.print()
    checks = [check for section in report.sections for check in section.checks]
    for check in checks:
        if check.outcome != "holds":
            lead = "FAILED" if check.outcome == "fails" else "undecided, use more --runs:"
            sys.stdout.write(
                f"{lead} {check.name}: expected {check.expected}, measured {check.measured}\n"
            )
    sys.stdout.write(f"{held_of(checks)}; see {folder / REPORT}\n")
