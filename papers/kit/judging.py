"""Checks and claims: a measured figure against what it must be. No caller can type a verdict.

A failed check fails the reproduction. A claim of the paper gets its verdict from findings: figures
with their intervals, and the range in which the claim needs each. A statement that no measurement
can refute is an erratum or a remark, and gets no verdict.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, Literal

import msgspec
import numpy as np
from scipy.special import stdtrit

from concord.results.figures.intervals import Interval

NamedFigures = dict[str, Any]
"""Measured figures by name: what a paper's checks and claims are made from."""
Verdict = Literal["holds", "does not hold", "not comparable", "contradicts itself"]
Test = Literal["every finding", "any open choice", "print against print"]

# A reproduction makes about a hundred checks; one in ten such reports may fail by chance.
CONFIDENCE = 0.999
_TOO_WIDE = 0.5
"""A band wider than this part of the expected value decides nothing."""


class Check(msgspec.Struct, frozen=True):
    """An assertion that must hold: what was expected, in words, and what was measured.

    An `undecided` one does not fail, as so few runs could not refute it.
    """

    name: str
    expected: str
    measured: float | str
    ok: bool
    undecided: bool = False

    @property
    def outcome(self) -> Literal["holds", "fails", "undecided"]:
        """The word for it."""
        return "undecided" if self.undecided else "holds" if self.ok else "fails"


def near(
    name: str, measured: Interval | float, expected: float, tolerance: float, unit: str = ""
) -> Check:
    """|measured - expected| <= tolerance; undecided where an end of it is in the interval."""
    words = f"{expected:g} ± {tolerance:g} {unit}".rstrip()
    return _in_band(name, words, measured, -tolerance, tolerance, middle=expected)


def at_most(name: str, measured: Interval | float, bound: float, unit: str = "") -> Check:
    """measured <= bound; undecided where the bound lies in the interval."""
    return _in_band(name, f"at most {bound:.10g} {unit}".rstrip(), measured, most=bound)


def above(name: str, measured: Interval | float, bound: float, unit: str = "") -> Check:
    """measured > bound; undecided where the bound lies in the interval."""
    least = float(np.nextafter(bound, np.inf))
    return _in_band(name, f"above {bound:g} {unit}".rstrip(), measured, least)


def below(name: str, measured: Interval | float, bound: float, unit: str = "") -> Check:
    """measured < bound; undecided where the bound lies in the interval."""
    most = float(np.nextafter(bound, -np.inf))
    return _in_band(name, f"below {bound:g} {unit}".rstrip(), measured, most=most)


def _in_band(
    name: str, words: str, measured: Interval | float, least: float = -np.inf,
    most: float = np.inf, middle: float = 0.0,
) -> Check:  # fmt: skip
    """The whole interval, less the middle, lies in [least, most]; NaN fails, and one run decides
    nothing."""
    is_interval = isinstance(measured, Interval)
    value, low, high = measured if is_interval else (measured,) * 3
    if is_interval and not np.isnan(value):
        low, high = (-np.inf if np.isnan(low) else low), (np.inf if np.isnan(high) else high)
    ok = bool(least <= low - middle and high - middle <= most)
    undecided = not ok and bool(low - middle <= most and high - middle >= least)
    return Check(name, words, float(value), ok or undecided, undecided)


def agrees(
    name: str, measured: Interval, runs: int, expected: float, *,
    of_runs: int | None = None, rounding: float = 0.0,
) -> Check:  # fmt: skip
    """The expected value is what so many runs allow, by their own 95 % interval.

    The check is undecided where they allow more than half as much again, or half as much.

    Args:
        measured: the mean of the runs with its interval.
        runs: how many runs the interval is of.
        of_runs: how many runs the expected value is the mean of; None if it is exact.
        rounding: half of the last digit that the expected value has.
    """
    widened = stdtrit(runs - 1, 0.5 + CONFIDENCE / 2) / stdtrit(runs - 1, 0.975)
    scatter = np.sqrt(1.0 + (0.0 if of_runs is None else runs / of_runs))
    less, more = (
        float(widened * scatter * side + rounding)
        for side in (measured.value - measured.low, measured.high - measured.value)
    )
    words = f"{expected:g} ± {less:g}"
    if not np.isclose(less, more):
        words = f"{expected - more:.4g} to {expected + less:.4g}"
    ok = bool(measured.value - less <= expected <= measured.value + more)
    undecided = ok and not max(less, more) <= _TOO_WIDE * abs(expected)
    return Check(name, words, float(measured.value), ok, undecided)


def refused(name: str, attempt: Callable[[], object], because: str) -> Check:
    """`attempt` raises a ValueError that says `because`."""
    try:
        attempt()
    except ValueError as error:
        return Check(name, f"refused: {because}", str(error), because in str(error))
    return Check(name, f"refused: {because}", "accepted", False)


def checks_from(rows: Iterable[tuple[Any, ...]], figures: NamedFigures) -> list[Check]:
    """Checks declared as data: rows of (form, name, figure, further arguments of the form).

    A form makes one check or several. `figure` is a dotted name in the figures, or a function of
    them that the form calls.
    """
    at = SimpleNamespace(**figures)
    checks: list[Check] = []
    for form, name, figure, *others in rows:
        value = (lambda f=figure: f(at)) if callable(figure) else attrgetter(figure)(at)
        made: Check | Iterator[Check] = form(name, value, *others)
        checks += [made] if isinstance(made, Check) else made
    return checks


class ClaimFinding(msgspec.Struct, frozen=True):
    """A figure, its interval, and the closed range in which the claim needs it."""

    value: float
    low: float
    high: float
    least: float
    most: float

    @property
    def proven(self) -> bool:
        """Whether the whole interval lies in the range; a NaN proves nothing."""
        return self.least <= self.low and self.high <= self.most

    @property
    def refuted(self) -> bool:
        """Whether the whole interval lies outside the range; a NaN refutes nothing."""
        return self.high < self.least or self.low > self.most


def needs(
    figure: Interval | float, *, at_least: float = -np.inf, at_most: float = np.inf
) -> ClaimFinding:
    """The claim needs the figure in [at_least, at_most]; a plain number has no spread."""
    value, low, high = figure if isinstance(figure, Interval) else (figure,) * 3
    return ClaimFinding(float(value), float(low), float(high), float(at_least), float(at_most))


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, its findings, and the verdict that follows from them.

    Attributes:
        where: equation, section, table or figure of the paper.
        says: the sentence.
        findings: at least one figure.
        measured: the findings in words.
        erratum: number of the erratum that the claim belongs to.
        test: how the findings make the verdict. "every finding": the claim needs all of them. "any
            open choice": each finding is of one choice of what the paper leaves open. "print
            against print": the findings relate what the paper prints in two places.
    """

    where: str
    says: str
    findings: Sequence[ClaimFinding]
    measured: str
    erratum: int | None = None
    test: Test = "every finding"
    verdict: Verdict = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", verdict_of(self.findings, self.test))


def verdict_of(findings: Sequence[ClaimFinding], test: Test = "every finding") -> Verdict:
    """The verdict that the findings allow.

    Findings that neither prove nor refute make the claim "not comparable": the runs are too few, or
    the outcome hangs on what the paper does not print.
    """
    if not findings:
        raise ValueError("a claim has no finding; a sentence that cannot fail is an erratum")
    refuted = [finding.refuted for finding in findings]
    if test == "print against print" and any(refuted):
        return "contradicts itself"
    if all(refuted) if test == "any open choice" else any(refuted):
        return "does not hold"
    return "holds" if all(finding.proven for finding in findings) else "not comparable"


class Erratum(msgspec.Struct, frozen=True):
    """One error of the paper: its place, the printed text and the correct text; no verdict."""

    number: int
    where: str
    printed: str
    correct: str


def errata_from(
    rows: Iterable[tuple[str, str, str]], added: dict[int, str] | None = None
) -> list[Erratum]:
    """Errata declared as data: rows of (where, printed, correct), numbered from 1.

    `added` has words that follow the correct text, by number: figures that belong to an erratum.
    """
    return [
        Erratum(number, where, printed, correct + (added or {}).get(number, ""))
        for number, (where, printed, correct) in enumerate(rows, start=1)
    ]
