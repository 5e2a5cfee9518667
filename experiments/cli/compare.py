"""`concord compare`: every fusion rule, and rules of your own, on a fixed suite of cases."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from concord.disk import RunFailed
from concord.experiments.standard_output import plain_console
from concord.experiments.user_errors import user_errors
from concord.results.places import make_folder
from concord.studies.compare.entries import asked_cases, check_together, entries_of, own_rules
from concord.studies.compare.output import write_comparison
from concord.studies.compare.results import assemble, comparison_figures
from concord.studies.compare.run import KEPT, compute_missing, kept_before
from concord.studies.compare.tables import as_json, print_comparison
from concord.studies.progress import progress
from concord.studies.sweep.engines import engine_for, workers_here

WIDTH = 80


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Which rules and cases, and where the results go."""

    rule: str | None = None
    """Rules of your own beside the built-in ones: FILE.py:NAME, several with commas."""
    case: str | None = None
    """Cases of the suite, with commas; all when left out."""
    runs: int | None = None
    """Monte-Carlo runs of every case that is not recorded; those of the suite when left out."""
    exact: bool = False
    """Take errors from exact second moments where a case and a rule have them."""
    data: Path | None = None
    """Folder of the data of recorded cases, which are skipped when left out."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; runs/compare when left out. Pairs of rule and case that it holds are
    not computed again."""
    workers: int | None = None
    """Processes on this machine; one per core when left out."""
    json: bool = False
    """Print one JSON object instead of tables."""


def compare(options: Annotated[CompareOptions, tyro.conf.arg(name="")]) -> None:
    """Compare all fusion rules, and your own, on a fixed suite of cases with fixed noise."""
    out = options.out or Path("runs") / "compare"
    with user_errors():
        cases = asked_cases(_listed(options.case), options.runs)
        own = own_rules(_listed(options.rule))
        data = None if options.data is None else str(options.data)
        engine = engine_for(options.workers, None)
        entries = entries_of(cases, own, data, options.exact)
        check_together(entries, workers_here(options.workers))
        make_folder(out, "--out")
    done = kept_before(entries, out)
    can_run = sum(not entry.reason for entry in entries)
    sys.stderr.write(
        f"{len(cases)} cases, {can_run} of {len(entries)} entries can run; {len(done)} of these "
        f"were computed before; results in {out}\n"
    )
    total = sum(e.case.runs for n, e in enumerate(entries) if not e.reason and n not in done)
    started = time.monotonic()
    try:
        with progress("runs", total, as_json=options.json) as on_runs:
            entries, figures = compute_missing(entries, done, out, engine, on_runs)
    except KeyboardInterrupt:
        sys.stderr.write(f"interrupted; finished entries are kept in {out / KEPT}, and the same "
                         f"command goes on from there\n")  # fmt: skip
        raise
    except RunFailed as error:
        raise RunFailed(f"{error}; finished entries are kept in {out / KEPT}") from error
    seconds = time.monotonic() - started
    dataset = assemble(entries, figures)
    found = comparison_figures(dataset)
    write_comparison(dataset, found, out)
    if options.json:
        sys.stdout.write(as_json(found).decode() + "\n")
        return
    console = plain_console(WIDTH)
    print_comparison(found, console)
    console.print(
        f"computed {can_run - len(done)} entries in {seconds:.1f} s; {out}/report.html",
    )


def _listed(text: str | None) -> list[str]:
    return [] if text is None else [part.strip() for part in text.split(",")]
