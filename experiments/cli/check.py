"""`concord check`: hold a user's value against the promises that concord relies on."""

import inspect
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
import tyro

from concord.bus.arbitration import ARBITERS, Arbiter
from concord.entries import summaries
from concord.experiments.user_errors import user_errors
from concord.filters.filter import Filter
from concord.scenarios.catalogue import definitions
from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_definition import ScenarioDefinition
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.user.values import is_source_name, source_of, value_of
from concord.studies.check.arbiter_promises import ARBITER_PROMISES, checked_arbiter
from concord.studies.check.filter_promises import FILTER_PROMISES, checked_filter
from concord.studies.check.promise import Promise, PromiseResult
from concord.studies.check.rule_promises import RULE_PROMISES, checked_rule
from concord.studies.check.scenario_promises import SCENARIO_PROMISES, checked_scenario
from concord.studies.sweep.engines import engine_for
from concord.topology.names import unknown_name


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Which cases, and how to show the result."""

    cases: int = 100
    """Number of cases for each promise."""
    case: int | None = None
    """Number of the only case."""
    promise: str | None = None
    """Name of the only promise."""
    consistent: bool = True
    """The rule claims that its covariance covers the error."""
    linear: bool = True
    """The filter claims to equal the Kalman filter on linear models."""
    workers: int | None = None
    """Processes on this machine for the random networks; one per core when left out."""
    json: bool = False
    """Print one JSON object."""


def check(
    subject: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(
            metavar="SUBJECT",
            help="A rule, a filter, an arbiter or a scenario, by its name or as FILE.py:NAME.",
        ),
    ],
    output: Annotated[CheckOptions, tyro.conf.OmitArgPrefixes],
) -> None:
    """Check the promises of a rule, a filter, an arbiter or a scenario in drawn cases; the exit
    code is 1 if one is broken."""
    with user_errors():
        if output.cases < 1:
            raise ValueError(f"--cases {output.cases}: must be at least 1")
        if output.case is not None and output.case < 1:
            raise ValueError(f"--case {output.case}: must be at least 1")
        cases = range(1, output.cases + 1) if output.case is None else [output.case]
        checked, promises = _subject(subject, output)
        names = [promise.name for promise in promises]
        if output.promise is not None and output.promise not in names:
            raise unknown_name("promise", output.promise, names)
    asked = [one for one in promises if output.promise in (None, one.name)]
    findings = {}
    for promise in asked:
        findings[promise.name] = promise.check(checked, cases)
        if not output.json:
            sys.stdout.write("\n".join(_lines(subject, promise, findings[promise.name])) + "\n")
            sys.stdout.flush()
    broken = sum(finding.status == "BROKEN" for finding in findings.values())
    if output.json:
        _write_json(subject, asked, findings)
    else:
        sys.stdout.write(f"{subject}: {broken} of {len(findings)} promises broken\n")
    sys.exit(1 if broken else 0)


def _subject(name: str, output: CheckOptions) -> tuple[Any, Sequence[Promise[Any]]]:
    """Return what a name means, and its promises.

    Raises:
        ValueError: it means nothing that can be checked.
    """
    engine = engine_for(output.workers, None)
    if is_source_name(name):
        value = value_of(source_of(name))
        is_scenario = isinstance(value, Scenario | ScenarioDefinition)
        is_filter, is_arbiter = isinstance(value, Filter), _is_arbiter(value)
    else:
        is_scenario, is_filter = name in definitions(), name in summaries("FILTERS")
        is_arbiter = name in ARBITERS
        if not (is_scenario or is_filter or is_arbiter or name in summaries("RULES")):
            known = [*summaries("RULES"), *summaries("FILTERS"), *ARBITERS, *definitions()]
            raise unknown_name("rule, filter, arbiter or scenario", name, known)
    if is_scenario:
        return checked_scenario(scenario_of(name)), SCENARIO_PROMISES
    if is_filter:
        return checked_filter(name, output.linear), FILTER_PROMISES
    if is_arbiter:
        return checked_arbiter(name), ARBITER_PROMISES
    return checked_rule(name, output.consistent, engine), RULE_PROMISES


def _is_arbiter(value: object) -> bool:
    """Whether it is an arbiter: its function takes a state, bids and frame IDs; a rule's two."""
    if isinstance(value, Arbiter):
        return True
    return inspect.isfunction(value) and len(inspect.signature(value).parameters) == 3


def _lines(subject: str, promise: Promise[Any], finding: PromiseResult) -> Iterator[str]:
    """Return the row of a promise, and the way to repeat a case."""
    yield f"{finding.status:8}{promise.name:14}{promise.says:43}{finding.seen}"
    if finding.values:
        numbers = {name: np.round(value, 4).tolist() for name, value in finding.values.items()}
        yield f"        smallest: {', '.join(f'{name} {value}' for name, value in numbers.items())}"
    if finding.status in ("BROKEN", "note"):
        yield f"        repeat: {_again(subject, promise, finding)}"


def _again(subject: str, promise: Promise[Any], finding: PromiseResult) -> str:
    case = [] if finding.case is None else ["--case", str(finding.case)]
    words = ["concord", "check", subject, "--promise", promise.name, *case]
    return finding.again or shlex.join(words)


def _write_json(
    subject: str, promises: Sequence[Promise[Any]], findings: dict[str, PromiseResult]
) -> None:
    rows = [
        {
            "promise": promise.name,
            "says": promise.says,
            **findings[promise.name]._asdict(),
            "again": _again(subject, promise, findings[promise.name]),
        }
        for promise in promises
    ]
    holds = not any(row["status"] == "BROKEN" for row in rows)
    result = {"subject": subject, "holds": holds, "promises": rows}
    sys.stdout.write(msgspec.json.encode(result).decode() + "\n")
