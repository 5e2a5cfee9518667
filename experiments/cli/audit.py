"""`concord audit`: account for each estimate, share, step, join and death of a run."""

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from concord.experiments.user_errors import user_errors
from concord.scenarios.user.trust import trust
from concord.studies.audit.report import AuditResult, audit


@dataclass(frozen=True)
class AuditOptions:
    """Which run."""

    folder: tyro.conf.Positional[Path]
    """Folder of a run."""
    json: bool = False
    """Print one JSON object instead of a table."""
    trust: Path | None = None
    """Folder whose own code and files may be used here: results of another user."""


def audit_folder(options: Annotated[AuditOptions, tyro.conf.arg(name="")]) -> None:
    """Account for each estimate, share, step, join and death of a run, from its recording; the exit
    code is 1 if a promise is broken."""
    with user_errors():
        trust(options.trust)
        found = audit(options.folder)
    if options.json:
        sys.stdout.write(_json(found))
    else:
        sys.stdout.write("\n".join(_lines(options.folder, found)) + "\n")
    sys.exit(1 if found.broken else 0)


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


def _json(found: AuditResult) -> str:
    promises = [{"says": promise.says, **finding._asdict()} for promise, finding in found.findings]
    result = {
        "holds": found.broken == 0,
        "promises": promises,
        "joins": [join._asdict() for join in found.joins],
        "events": [one._asdict() for one in found.around],
    }
    return msgspec.json.encode(result).decode() + "\n"
