"""Entries of a comparison: every rule on every case, checked before the first one runs."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec

from concord.entries import summaries
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from concord.scenarios.rule_table.rules import rule_of
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.user.values import is_source_name
from concord.studies.compare.suite import Case, suite
from concord.studies.memory import check_workers, needed_bytes
from concord.studies.sweep.cells import sorted_out
from concord.studies.sweep.pieces import program, runs_at_once
from concord.studies.sweep.specification import Specification, cells_of, specify
from concord.topology.names import unknown_name

DATA_MISSING = "it replays recorded data: name their folder with --data"


class ComparedEntry(NamedTuple):
    """A rule on a case; `reason` says why it cannot run there, and is empty where it can.

    `rule` is its name in tables.
    """

    case: Case
    rule: str
    specification: Specification | None
    reason: str = ""

    @property
    def digest(self) -> str:
        """Digest of all that the figures follow from: options, rule's file, version and commit."""
        content = msgspec.json.encode((self.specification, program()))
        return hashlib.sha256(content).hexdigest()[:24]

    @property
    def is_kept(self) -> bool:
        """Whether its figures may be kept: a file has the rule, or concord itself."""
        assert self.specification is not None, "the entry can run"
        return all(self.specification.digests.values())


def asked_cases(names: Sequence[str] | None, runs: int | None) -> list[Case]:
    """Return the cases of these names, all where None; with so many runs each.

    Raises:
        ValueError: an unknown name, or no run.
    """
    if runs is not None and runs < 1:
        raise ValueError(f"--runs {runs}: must be at least 1")
    by_name = {case.name: case for case in suite()}
    for name in names or ():
        if name not in by_name:
            raise unknown_name("case", name, by_name)
    cases = [by_name[name] for name in dict.fromkeys(names)] if names else list(suite())
    return [case if runs is None or case.recorded else case._replace(runs=runs) for case in cases]


def own_rules(names: Sequence[str]) -> dict[str, str]:
    """Return the rules of the user by name, each of which can be read.

    Raises:
        ValueError: a name that is none, twice there or built in, or no rule in its file.
    """
    for place, name in enumerate(names):
        if name in summaries("RULES"):
            raise ValueError(
                f"--rule {name}: every built-in rule takes part anyway; name a rule of your own as "
                "FILE.py:NAME, or leave --rule out"
            )
        if not is_source_name(name):
            raise ValueError(f"--rule {name}: must be FILE.py:NAME, such as ./mine.py:RULE")
        if name in names[:place]:
            raise ValueError(f"--rule {name}: it is there twice; name each rule once")
        rule_of(scenario_of("oscillator", rule=name))
    return {name: name for name in names}


def entries_of(
    cases: Sequence[Case], own: Mapping[str, str], data: str | None, exact: bool = False
) -> list[ComparedEntry]:
    """Return each rule on each case, case by case; `own` are sources of rules by name, and with
    `exact` figures need no noise where a case and a rule have exact ones.

    Raises:
        ValueError: recorded data that cannot be read.
    """
    if data is not None:
        recorded = [case for case in cases if case.recorded]
        if not recorded:
            raise ValueError(f"--data {data}: none of the cases is recorded; leave it out")
        for case in recorded:
            (cell,) = cells_of(specify({**case.options, "data": data}, runs=1))
            prepare(cell.scenario)
    rules = {name: name for name in summaries("RULES")} | dict(own)
    return [
        _entry(case, name, source, data, exact) for case in cases for name, source in rules.items()
    ]


def check_together(entries: Sequence[ComparedEntry], workers: int) -> None:
    """Refuse a comparison whose entries do not fit into the memory of so many workers at once.

    Raises:
        ValueError: naming the estimate and the cure.
    """
    needs = []
    for entry in entries:
        if entry.specification is not None and not entry.reason:
            (cell,) = cells_of(entry.specification)
            runs = min(entry.case.runs, runs_at_once(cell.scenario))
            needs.append(needed_bytes(cell.scenario, runs))
    check_workers(needs, workers)


def _entry(case: Case, name: str, source: str, data: str | None, exact: bool) -> ComparedEntry:
    options = {**case.options, "rule": source}
    network = definition_named(case.options["scenario"]).defaults
    if hasattr(network.with_known(rule=source)[0].rule, "number"):
        options["number"] = "float64"
    if case.recorded:
        if data is None:
            return ComparedEntry(case, name, None, DATA_MISSING)
        options["data"] = data
    specification = specify(options, runs=case.runs, exact=exact)
    _, bad = sorted_out(cells_of(specification))
    return ComparedEntry(case, name, specification, str(bad[0][1]) if bad else "")
