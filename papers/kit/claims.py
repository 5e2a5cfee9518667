"""Claims of a paper. A verdict is computed from findings; no caller can type one.

A finding is a figure with its interval, and the range in which the claim needs the figure. A
statement that no measurement can refute is an erratum or a remark, and gets no verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import numpy as np

from concord.results.figures.intervals import Interval

Verdict = Literal["holds", "does not hold", "not comparable", "contradicts itself"]
Test = Literal["every finding", "any open choice", "print against print"]


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
