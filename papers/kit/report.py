"""The report of a reproduction: sections with checks, claims and errata, for people and machines.

A reproduction is a generator of sections. `report.md` and `report.json` are rewritten after each.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from concord.disk import writing
from concord.papers.kit.judging import Check, Claim, Erratum
from concord.results.folder import versions

REPORT, REPORT_JSON = "report.md", "report.json"


class Section(msgspec.Struct, frozen=True):
    """A part of the report: Markdown `text`, and the values behind it for machines.

    `place` orders the sections, whatever the order in which they were computed. The text of a
    section that is `shown` is printed on the terminal too.
    """

    place: int
    title: str
    text: str = ""
    checks: list[Check] = []
    claims: list[Claim] = []
    errata: list[Erratum] = []
    data: dict[str, Any] = {}
    shown: bool = False


class ReproductionReport(msgspec.Struct, frozen=True):
    """A reproduction as far as it has come. `ok`: it is complete and every check holds."""

    paper: str
    seed: int
    runs: int
    versions: dict[str, str]
    complete: bool
    ok: bool
    sections: list[Section]


class Paper(NamedTuple):
    """How a paper is reproduced.

    Attributes:
        title: of the report.
        seed: the seed unless the user gives one.
        runs: the number of Monte Carlo runs unless the user gives one.
        least_runs: fewer runs make no report.
        because: the reason for `least_runs`.
        sections: (folder, seed, runs) -> the sections as they get ready.
    """

    title: str
    seed: int
    runs: int
    least_runs: int
    because: str
    sections: Callable[[Path, int, int], Iterator[Section]]


def check_runs(paper: Paper, runs: int) -> None:
    """Refuse too few runs.

    Raises:
        ValueError: fewer than the paper's least number of runs.
    """
    if runs < paper.least_runs:
        raise ValueError(f"--runs {runs}: must be at least {paper.least_runs}, {paper.because}")


def report_of(
    paper: str, seed: int, runs: int, sections: Sequence[Section], *, complete: bool
) -> ReproductionReport:
    """The report of the sections that are ready."""
    ordered = sorted(sections, key=lambda section: section.place)
    holds = all(check.ok for section in ordered for check in section.checks)
    used = versions("control", "matplotlib")
    return ReproductionReport(paper, seed, runs, used, complete, complete and holds, ordered)


def write_report(report: ReproductionReport, title: str, folder: Path) -> None:
    """Write `report.md` and `report.json`.

    Raises:
        NotWritten: the disk does not take them.
    """
    with writing(folder / REPORT):
        (folder / REPORT).write_text(to_markdown(report, title), encoding="utf-8")
    with writing(folder / REPORT_JSON):
        (folder / REPORT_JSON).write_bytes(msgspec.json.encode(report))


def to_markdown(report: ReproductionReport, title: str) -> str:
    """The report for people."""
    parts = [f"# {title}", _summary(report)]
    for section in report.sections:
        parts.append(f"## {section.title}")
        parts += [part for part in (section.text, *_tables(section)) if part]
    return "\n\n".join(parts) + "\n"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; characters that would end a cell are escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def held_of(checks: Sequence[Check]) -> str:
    """ "9 of 10 checks hold", and how many are undecided."""
    counts = Counter(check.outcome for check in checks)
    more = f", {counts['undecided']} undecided" if counts["undecided"] else ""
    return f"{counts['holds']} of {len(checks)} checks hold{more}"


def _summary(report: ReproductionReport) -> str:
    checks = [check for section in report.sections for check in section.checks]
    failed, undecided = (
        [check.name for check in checks if check.outcome == outcome]
        for outcome in ("fails", "undecided")
    )
    claims = [claim.verdict for section in report.sections for claim in section.claims]
    errata = sum(len(section.errata) for section in report.sections)
    versions = ", ".join(f"{name} {number}" for name, number in report.versions.items())
    lines = [f"Seed {report.seed}, {report.runs} runs; {versions}.", ""]
    if not report.complete:
        lines += ["**Not complete: the run was interrupted, or is still under way.**", ""]
    lines.append(f"{held_of(checks)}.")
    if undecided:
        lines += ["", "**Undecided: use more --runs.**", *(f"- {name}" for name in undecided)]
    if failed:
        lines += ["", "**Failed:**", *(f"- {name}" for name in failed)]
    if claims:
        counts = ", ".join(f"{claims.count(verdict)} {verdict}" for verdict in sorted(set(claims)))
        lines += ["", f"Claims of the paper: {counts}."]
    if errata:
        lines += ["", f"Errata: {errata}."]
    return "\n".join(lines)


def claim_tables(section: Section) -> Iterator[str]:
    """Yield the tables of the claims and of the errata of a section."""
    if section.claims:
        rows = [
            (
                claim.where,
                claim.says,
                f"**{claim.verdict}**" + (f" (erratum {claim.erratum})" if claim.erratum else ""),
                claim.measured,
            )
            for claim in section.claims
        ]
        yield markdown_table(("where", "the paper says", "verdict", "what was measured"), rows)
    if section.errata:
        rows = [(str(e.number), e.where, e.printed, e.correct) for e in section.errata]
        yield markdown_table(("number", "where", "printed", "correct"), rows)


def _tables(section: Section) -> Iterator[str]:
    yield from claim_tables(section)
    if section.checks:
        rows = [
            (
                check.name,
                check.expected,
                check.measured if isinstance(check.measured, str) else f"{check.measured:.6g}",
                {"holds": "yes", "fails": "**NO**"}.get(check.outcome, check.outcome),
            )
            for check in section.checks
        ]
        yield markdown_table(("check", "expected", "measured", "holds"), rows)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
