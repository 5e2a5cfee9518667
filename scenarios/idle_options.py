"""Options that change nothing beside others: said before the run, as they cost no more than a line.

They are not refused: a sweep crosses rules with the options of one of them.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from nodes.commands import Configure
from scenarios.catalogue import kind_of
from scenarios.labelled import LABELLED_FIELDS
from scenarios.rules import rules_where
from scenarios.scenario import Scenario
from scenarios.script import script_of
from scenarios.setup import Setup, complete_settings, with_settings


class _Reader(NamedTuple):
    """Whether a scenario reads an option, and in the words of the options what it is for."""

    reads: Callable[[Scenario], bool]
    purpose: str


def idle_options(setup: Setup) -> Iterator[str]:
    """A sentence for every option that is not as it was and that nothing reads, from the first
    step to the last change of `--changes`."""
    scenario = setup.scenario
    usual = kind_of(scenario.name).defaults
    stages = _stages(setup)
    for field, reader in _READERS.items():
        value = getattr(scenario, field)
        if value != getattr(usual, field) and not any(map(reader.reads, stages)):
            yield (
                f"--{field.replace('_', '-')} {value} changes nothing here: it is for "
                f"{reader.purpose}; leave it out, or use that"
            )


def _stages(setup: Setup) -> list[Scenario]:
    """The scenario as it begins, and as it is after every `set` of its script."""
    stages, settings = [setup.scenario], {}
    for _, command in script_of(setup.scenario):
        if isinstance(command, Configure):
            settings = complete_settings(setup, {**settings, **command.settings})
            stages.append(with_settings(setup, settings).scenario)
    return stages


def _of_rules(field: str) -> _Reader:
    rules = rules_where(lambda rule: field in rule.own) or rules_where(
        lambda rule: field not in rule.ignores
    )
    return _Reader(lambda scenario: scenario.rule in rules, f"rule {_listed(rules)} alone")


def _of_decayed(field: str) -> _Reader:
    rules = rules_where(lambda rule: rule.holds and field not in rule.ignores)
    return _Reader(
        lambda scenario: scenario.rule in rules and scenario.hold == "decayed",
        f"rule {_listed(rules)} with --hold decayed alone",
    )


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last


def _is_contended(scenario: Scenario) -> bool:
    # A measurement bus has a slot for which its sensors contend.
    return scenario.schedule in _CONTENDED or kind_of(scenario.name).wiring is not None


_CONTENDED = ("hybrid", "hybrid-leaves", "dynamic")
_AT_CONTENTION = _Reader(_is_contended, f"--schedule {_listed(_CONTENDED)} alone")
_READERS = {
    "weights": _of_rules("weights"),
    "arbiter": _AT_CONTENTION,
    "trigger": _AT_CONTENTION,
    "decay": _of_decayed("decay"),
    "determinant_weights": _of_decayed("determinant_weights"),
    "liars": _of_rules("liars"),
    # A measurement bus carries numbers too, under rules of its own.
    "number": _Reader(lambda scenario: scenario.rule != "labelled", "all rules but labelled"),
    "latch_delay_us": _Reader(lambda scenario: scenario.relay, "--relay True alone"),
    **{field: _of_rules(field) for field in LABELLED_FIELDS},
}
