"""Result of an audit: promises, joins, and consistency around events."""

from bisect import bisect_right
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from concord.results.figures.intervals import chi_square_quantile
from concord.scenarios.rule_table.rules import is_set_valued
from concord.studies.audit.evidence import Evidence, read_evidence
from concord.studies.audit.member_history import member_history_of
from concord.studies.audit.promises import PROMISES, Account, Run, RunPromise, source_of

_STEPS_AROUND = 10
_LONGEST_VALUE = 40
_RARE = 0.999
# The recorder of a run whose environment is killed loses what is under way.
_STEPS_CUT = 10


class Join(NamedTuple):
    """A return: its step, the node, the node of whose estimate it begins (None: the prior, or none)
    and the age of that estimate in steps."""

    step: int
    node: int
    source: int | None
    age_steps: int | None


class Around(NamedTuple):
    """Mean NEES of all nodes in the ten steps before an event, and in those from it to the next
    event, ten at most; NaN if unknown.

    `jumps`: after the event it exceeds, in a step, a bound that it kept before. The bound is the
    99.9 % quantile of one node's NEES; a mean over nodes exceeds it more rarely.
    """

    step: int
    event: str
    before: float
    after: float
    jumps: bool


class AuditResult(NamedTuple):
    """Result of an audit."""

    findings: tuple[tuple[RunPromise, Account], ...]
    joins: tuple[Join, ...]
    around: tuple[Around, ...]

    @property
    def broken(self) -> int:
        """Number of broken promises."""
        return sum(finding.broken > 0 for _, finding in self.findings)


def audit(folder: Path) -> AuditResult:
    """Audit the folder of a run.

    Raises:
        ValueError: it holds no recording or no arrays.
    """
    evidence = read_evidence(folder)
    nodes = evidence.scenario.nodes
    membership = member_history_of(evidence.scenario.rounds, evidence.events)
    times = evidence.arrays["time"].values
    time_step_s = float(times[1] - times[0]) if len(times) > 1 else 1.0
    run = Run(evidence, membership, nodes, 0, time_step_s)
    run = run._replace(complete=_complete(run))
    return AuditResult(
        tuple((promise, promise.check(run)) for promise in PROMISES),
        tuple(_joins(run)),
        tuple(_around(evidence)),
    )


def _complete(run: Run) -> int:
    """Return the number of steps, without those that an early end has cut off."""
    said = run.evidence
    last = max(said.truths, default=-1)
    if said.in_real_time:
        return min(last, max((step for step, _ in said.estimates), default=-1)) + 1
    complete = last + 1
    if complete < said.scenario.steps:
        while complete > max(last + 1 - _STEPS_CUT, 0) and not _is_whole(run, complete - 1):
            complete -= 1
    return complete


def _is_whole(run: Run, step: int) -> bool:
    return all(
        (step, node) in run.evidence.estimates
        for node in range(run.nodes)
        if run.membership.is_in(node, step)
    )


def _joins(run: Run) -> list[Join]:
    joins = []
    for step, change in run.evidence.events:
        if change["what"] == "joined":
            known = change.get("mean") is not None
            of = step - 1 if change.get("step") is None else change["step"]
            source = source_of(run, step, change) if known else None
            joins.append(Join(step, change["node"], source, step - 1 - of if known else None))
    return joins


def _around(evidence: Evidence) -> list[Around]:
    if is_set_valued(evidence.scenario):
        return []
    nees = evidence.arrays["nees"]
    bound = chi_square_quantile(_RARE, len(np.atleast_1d(nees.attrs["states"])))
    values = np.ma.masked_invalid(nees.values).mean(axis=1).filled(np.nan)
    found = []
    events = [one for one in evidence.events if one[1]["what"] != "pace"]
    # The last one is beyond all events.
    steps = [*sorted({step for step, _ in events}), len(values)]
    for step, change in events:
        next_step = steps[bisect_right(steps, step, hi=len(steps) - 1)]
        before = values[max(step - _STEPS_AROUND, 0) : step]
        after = values[step : min(step + _STEPS_AROUND, next_step)]
        jumps = bool((after > bound).any() and not (before > bound).any())
        found.append(Around(step, _words(change), _mean(before), _mean(after), jumps))
    return found


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _brief(value: object) -> str:
    """Return a value; of a long one, such as all links of a graph, only how it begins."""
    text = str(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def _words(change: dict[str, Any]) -> str:
    """Return an event in the words of `--changes`."""
    match change:
        case {"what": "left" | "gone" | "joined" as what, "node": node}:
            return f"{what} {node}"
        case {"what": "settings", "settings": settings}:
            return "set " + " ".join(f"{name}={_brief(value)}" for name, value in settings.items())
        case {"what": "fault", "kind": kind, "nodes": nodes, "numbers": numbers}:
            return " ".join([kind, *map(str, nodes), *(f"{number:g}" for number in numbers)])
        case _:
            values = [str(value) for name, value in change.items() if name != "what"]
            return " ".join([change["what"], *values])
