"""Findings on runs, and the verdict that they make: a level, the first cause, and its cure."""

from collections.abc import Sequence
from typing import Literal

import msgspec

from concord.results.figures.intervals import Interval

VerdictLevel = Literal["FAILED", "CHECK", "WORKS"]
LEVELS: tuple[VerdictLevel, ...] = ("FAILED", "CHECK", "WORKS")
MARGIN = 1.1
"""Least ratio of ANEES to 1, or of 1 to it, that is called over- or underconfident."""


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """One finding on runs.

    Attributes:
        level: FAILED makes every figure meaningless or the network useless; CHECK casts doubt;
            WORKS is no fault.
        cause: a few words that stay the same, for programs.
        said: the sentence, with its numbers.
        cure: what would help; empty for nothing.
        node, sensor: where; None for the network.
        first_step, count: since which step, and how often, where that is told.
    """

    level: VerdictLevel
    cause: str
    said: str
    cure: str = ""
    node: int | None = None
    sensor: str | None = None
    first_step: int | None = None
    count: int | None = None

    def in_words(self) -> str:
        """Return the sentence and its cure."""
        return f"{self.said}; {self.cure}" if self.cure else self.said


class VerdictOnRuns(msgspec.Struct, frozen=True):
    """The level, cause and sentence of the first finding, and all findings, the gravest first."""

    level: VerdictLevel
    cause: str
    said: str
    findings: list[Finding]

    @property
    def has_failed(self) -> bool:
        """Whether the level is FAILED: commands end with exit code 1."""
        return self.level == "FAILED"

    def in_words(self) -> str:
        """Return "CHECK: sentence; cure"."""
        return f"{self.level}: {self.findings[0].in_words()}"


def verdict_of(findings: Sequence[Finding]) -> VerdictOnRuns:
    """Return the verdict of findings in the order in which they make others meaningless; there is
    at least one."""
    ordered = sorted(findings, key=lambda one: LEVELS.index(one.level))
    first = ordered[0]
    return VerdictOnRuns(first.level, first.cause, first.said, ordered)


def beyond(found: Interval) -> str:
    """ "overconfident" or "underconfident" of a figure that is 1 where estimates claim what they
    know; empty where its interval holds 1, or where it departs by less than `MARGIN`."""
    if found.low > 1 and found.value > MARGIN:
        return "overconfident"
    if found.high < 1 and found.value < 1 / MARGIN:
        return "underconfident"
    return ""
