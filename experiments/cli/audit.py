"""`concord audit`: account for each estimate, share, step, join and death of a run."""

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tyro

from concord.experiments.user_errors import user_errors
from concord.scenarios.user.trust import trust
from concord.studies.audit.again import Again, computed_again
from concord.studies.audit.report import AuditResult, audit

_MOST_LINES = 100


@dataclass(frozen=True)
class AuditOptions:
    """Which run."""

    folder: tyro.conf.Positional[Path]
    """Folder of a run."""
    json: bool = False
    """Print one JSON object instead of a table."""
    again: bool = False
    """Also compute a run in lockstep again, and compare every message and number to the bit."""
    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def audit_folder(options: Annotated[AuditOptions, tyro.conf.arg(name="")]) -> None:
    """Account for each estimate, share, step, join and death of a run, from its recording; the exit
    code is 1 if a promise is broken."""
    with user_errors():
        trust(options.trust)
        found = audit(options.folder)
        again = computed_again(options.folder) if options.again else None
    if options.json:
        sys.stdout.write(_json(found, again))
    else:
        told = [*_lines(options.folder, found), *(_lines_again(again) if again else ())]
        sys.stdout.write("\n".join(told) + "\n")
    sys.exit(1 if found.broken or (again and again.differences) else 0)


def _lines_again(again: Again) -> Iterator[str]:
    for difference in again.differences[:_MOST_LINES]:
        yield f"DIFFERS {difference}"
    if len(again.differences) > _MOST_LINES:
        yield f"DIFFERS {len(again.differences) - _MOST_LINES} more"
    differ = len(again.differences)
    end = (
        f"; later ones not, as {again.ends}, and its last words depend on that"
        if again.ends
        else ""
    )
    yield f"again   {again.messages} messages of {again.steps} steps computed: {differ} differ{end}"


def _lines(folder: Path, found: AuditResult) -> Iterator[str]:
    for promise, finding in found.findings:
        status = "BROKEN" if finding.broken else "holds"
        seen = f"{finding.broken} of {finding.checked}" if finding.broken else f"{finding.checked}"
        first = f"first: {finding.first}" if finding.broken else ""
        said = "; ".join(text for text in (seen, finding.note, first) if text)
        yield f"{status:8}{promise.says:52}{said}"
    for join in found.joins:
        belief = "its prior" if join.source is None else f"the estimate of node {join.source}"
        age = "" if not join.age_steps else f", {join.age_steps} steps old, which it predicts"
        yield f"join    step {join.step}: node {join.node} begins with {belief}{age}"
    for one in found.around:
        mark = "  <- look here" if one.jumps else ""
        change = f"mean NEES {_number(one.before)} before, {_number(one.after)} after{mark}"
        yield f"event   step {one.step}: {one.event}: {change}"
    yield f"{folder}: {found.broken} of {len(found.findings)} promises broken"


def _number(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{value:.2f}"


def _json(found: AuditResult, again: Again | None) -> str:
    promises = [{"says": promise.says, **finding._asdict()} for promise, finding in found.findings]
    result: dict[str, Any] = {
        "holds": found.broken == 0 and not (again and again.differences),
        "promises": promises,
        "joins": [join._asdict() for join in found.joins],
        "events": [one._asdict() for one in found.around],
    }
    if again is not None:
        result["again"] = again._asdict()
    return msgspec.json.encode(result).decode() + "\n"
