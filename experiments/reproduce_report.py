"""What the reproduction of a paper amounts to: checks, claims and tables, for people and machines.

A reproduction is a generator of sections. Nothing in a section is typed that could be computed: a
check holds what was measured against what was expected, a claim gets its verdict from numbers.
"""

import platform
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

REPORT = "report.md"

Verdict = Literal["reproduced", "not reproducible as printed", "wrong"]


class Check(msgspec.Struct, frozen=True):
    """An assertion that must hold: what was expected, in words, and what was measured."""

    name: str
    expected: str
    measured: float | str
    ok: bool


class Claim(msgspec.Struct, frozen=True):
    """What a paper says, where, and what came of it; `erratum` is its number in the list."""

    where: str
    says: str
    verdict: Verdict
    measured: str
    erratum: int | None = None


class Section(msgspec.Struct, frozen=True):
    """A part of the report: Markdown `text`, and what of it is for machines.

    `place` orders the sections, whatever the order in which they were computed. The text of a
    section that is `shown` is printed on the terminal too.
    """

    place: int
    title: str
    text: str = ""
    checks: list[Check] = []
    claims: list[Claim] = []
    data: dict[str, Any] = {}
    shown: bool = False


class Report(msgspec.Struct, frozen=True):
    """A reproduction as far as it has come. `ok`: it is complete and every check holds."""

    paper: str
    seed: int
    versions: dict[str, str]
    complete: bool
    ok: bool
    sections: list[Section]


class Reproduction(NamedTuple):
    """How a paper is reproduced: its title, its seed, and its sections as they get ready."""

    title: str
    seed: int
    sections: Callable[[Path], Iterator[Section]]


# --- checks --------------------------------------------------------------------------------------


def near(name: str, measured: float, expected: float, tolerance: float, unit: str = "") -> Check:
    """|measured - expected| <= tolerance; a measured NaN fails."""
    words = f"{expected:g} ± {tolerance:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(abs(measured - expected) <= tolerance))


def at_most(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured <= bound."""
    words = f"at most {bound:.10g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured <= bound))


def above(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured > bound."""
    words = f"above {bound:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured > bound))


def below(name: str, measured: float, bound: float, unit: str = "") -> Check:
    """measured < bound."""
    words = f"below {bound:g} {unit}".rstrip()
    return Check(name, words, float(measured), bool(measured < bound))


def refused(name: str, attempt: Callable[[], object], because: str) -> Check:
    """`attempt` raises a ValueError that says `because`."""
    try:
        attempt()
    except ValueError as error:
        return Check(name, f"refused: {because}", str(error), because in str(error))
    return Check(name, f"refused: {because}", "accepted", False)


# --- the report ----------------------------------------------------------------------------------


def report_of(paper: str, seed: int, sections: Sequence[Section], *, complete: bool) -> Report:
    """The report of the sections there are."""
    ordered = sorted(sections, key=lambda section: section.place)
    holds = all(check.ok for section in ordered for check in section.checks)
    return Report(paper, seed, _versions(), complete, complete and holds, ordered)


def to_markdown(report: Report, title: str) -> str:
    """The report for people."""
    parts = [f"# {title}", _summary(report)]
    for section in report.sections:
        parts.append(f"## {section.title}")
        if section.text:
            parts.append(section.text)
        if section.claims:
            parts.append(_claims_table(section.claims))
        if section.checks:
            parts.append(_checks_table(section.checks))
    return "\n\n".join(parts) + "\n"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; what would end a cell is escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _summary(report: Report) -> str:
    checks = [check for section in report.sections for check in section.checks]
    failed = [check.name for check in checks if not check.ok]
    claims = [claim.verdict for section in report.sections for claim in section.claims]
    versions = ", ".join(f"{name} {number}" for name, number in report.versions.items())
    lines = [f"Seed {report.seed}; {versions}.", ""]
    if not report.complete:
        lines += ["**Not complete: the run was interrupted, or is still under way.**", ""]
    lines.append(f"{len(checks) - len(failed)} of {len(checks)} checks hold.")
    if failed:
        lines += ["", "**Failed:**", *(f"- {name}" for name in failed)]
    if claims:
        counts = ", ".join(f"{claims.count(verdict)} {verdict}" for verdict in sorted(set(claims)))
        lines += ["", f"Claims of the paper: {counts}."]
    return "\n".join(lines)


def _claims_table(claims: Sequence[Claim]) -> str:
    rows = [
        (
            claim.where,
            claim.says,
            f"**{claim.verdict}**" + (f" (erratum {claim.erratum})" if claim.erratum else ""),
            claim.measured,
        )
        for claim in claims
    ]
    return markdown_table(("where", "the paper says", "verdict", "what was measured"), rows)


def _checks_table(checks: Sequence[Check]) -> str:
    rows = [
        (
            check.name,
            check.expected,
            check.measured if isinstance(check.measured, str) else f"{check.measured:.6g}",
            "yes" if check.ok else "**NO**",
        )
        for check in checks
    ]
    return markdown_table(("check", "expected", "measured", "holds"), rows)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _versions() -> dict[str, str]:
    names = ("concord", "numpy", "scipy", "networkx", "control", "matplotlib")
    return {name: version(name) for name in names} | {"python": platform.python_version()}
