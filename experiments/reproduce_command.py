"""`concord reproduce`: a paper's figures and tables, and what became of its claims."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from rich.console import Console

from experiments.reproduce_report import REPORT, Report, Reproduction, report_of, to_markdown
from experiments.results import new_folder
from experiments.user_errors import user_errors
from nodes.disk import writing
from topology.names import unknown_name


def _wac(runs: int | None) -> Reproduction:
    # Only here: it draws pictures and designs controllers, which takes long to import.
    from experiments.reproduce_wac import REPRODUCTION

    if runs is not None:
        raise ValueError(f"--runs {runs}: wac has runs of its own; leave --runs out")
    return REPRODUCTION


def _meng2025(runs: int | None) -> Reproduction:
    # Only here: it draws pictures.
    from experiments.reproduce_meng2025 import reproduction

    return reproduction(runs)


def _adlukf(runs: int | None) -> Reproduction:
    # Only here: it draws pictures and simulates cars.
    from experiments.reproduce_adlukf import SEEDS, reproduction

    return reproduction(SEEDS if runs is None else runs)


def _liu2021(runs: int | None) -> Reproduction:
    # Only here: it draws pictures.
    from experiments.reproduce_liu2021 import SEQUENCES, reproduction

    return reproduction(SEQUENCES if runs is None else runs)


def _labelled(runs: int | None) -> Reproduction:
    # Only here: it draws pictures.
    from experiments.reproduce_labelled import reproduction

    return reproduction(runs)


REPRODUCTIONS: dict[str, Callable[[int | None], Reproduction]] = {
    "wac": _wac,
    "meng2025": _meng2025,
    "adlukf": _adlukf,
    "labelled": _labelled,
    "liu2021": _liu2021,
}


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Which paper, and where to put what comes of it."""

    paper: Annotated[str, tyro.conf.Positional]
    """wac: the weighted-average-consensus UKF of Widjiantoro et al.; meng2025: the UKF under the
    FlexRay protocol of Meng et al.; adlukf: the adaptive dual-layer UKF of Wang et al.; liu2021:
    set membership over a FlexRay network of Liu et al.; labelled: the project's own study of
    labelled measurements beside consensus on beliefs."""
    out: Path
    """Folder for the report and the pictures. It must not exist."""
    runs: Annotated[int | None, tyro.conf.arg(aliases=["--seeds", "--sequences"])] = None
    """Runs of a Monte Carlo, for papers that have one; as many as in the paper if left out."""
    json: bool = False
    """Print one JSON object instead of a summary."""


def reproduce(options: Annotated[ReproduceOptions, tyro.conf.arg(name="")]) -> None:
    """Reproduce a paper; exit code 1 if a check fails."""
    with user_errors():
        if options.paper not in REPRODUCTIONS:
            raise unknown_name("paper", options.paper, REPRODUCTIONS)
        reproduction = REPRODUCTIONS[options.paper](options.runs)
        _, folder = new_folder(options.out, options.paper)
    sys.stderr.write(f"seed {reproduction.seed}; results in {folder}\n")
    started = time.monotonic()
    report = carry_out(options.paper, reproduction, folder)
    sys.stderr.write(f"done in {time.monotonic() - started:.0f} s\n")
    _show(report, folder, options.json)
    if not report.ok:
        sys.exit(1)


def carry_out(paper: str, reproduction: Reproduction, folder: Path) -> Report:
    """The whole reproduction, section by section on standard error. The report in `folder` is at
    every time as far as the work."""
    done = []
    for section in reproduction.sections(folder):
        done.append(section)
        sys.stderr.write(f"done: {section.title}\n")
        sys.stderr.flush()
        report = report_of(paper, reproduction.seed, done, complete=False)
        _write(report, reproduction, folder)
    report = report_of(paper, reproduction.seed, done, complete=True)
    _write(report, reproduction, folder)
    return report


def _write(report: Report, reproduction: Reproduction, folder: Path) -> None:
    with writing(folder / REPORT):
        (folder / REPORT).write_text(to_markdown(report, reproduction.title), encoding="utf-8")


def _show(report: Report, folder: Path, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
        return
    # Only here: it takes a tenth of a second to import.
    from rich.markdown import Markdown

    console = Console()
    for section in report.sections:
        if section.shown:
            console.print(Markdown(f"## {section.title}\n\n{section.text}"))
            console.print()
    checks = [check for section in report.sections for check in section.checks]
    for check in checks:
        if not check.ok:
            sys.stdout.write(
                f"FAILED {check.name}: expected {check.expected}, measured {check.measured}\n"
            )
    held = sum(check.ok for check in checks)
    sys.stdout.write(f"{held} of {len(checks)} checks hold; see {folder / REPORT}\n")
