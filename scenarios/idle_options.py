"""Options that change nothing beside others: said before the run, as they cost no more than a line.

They are not refused: a sweep crosses rules with the options of one of them.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from nodes.commands import Configure
from scenarios.bus_plan import has_contenders
from scenarios.catalogue import kind_of
from scenarios.rules import rules_by_own_field, rules_where
from scenarios.script import script_of
from scenarios.setup import Setup, complete_settings, with_settings


class _Reader(NamedTuple):
    """Whether a setup reads an option, and in the words of the options what it is for."""

    reads: Callable[[Setup], bool]
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


def _stages(setup: Setup) -> list[Setup]:
    """The setup as it begins, and as it is after every `set` of its script."""
    stages, settings = [setup], {}
    for _, command in script_of(setup.scenario):
        if isinstance(command, Configure):
            settings = complete_settings(setup, {**settings, **command.settings})
            stages.append(with_settings(setup, settings))
    return stages


def _of_rules(rules: Sequence[str]) -> _Reader:
    return _Reader(lambda setup: setup.scenario.rule in rules, f"rule {_listed(rules)} alone")


def _of_decayed(field: str) -> _Reader:
    rules = rules_where(lambda rule: rule.holds and field not in rule.ignores)
    return _Reader(
        lambda setup: setup.scenario.rule in rules and setup.scenario.hold == "decayed",
        f"rule {_listed(rules)} with --hold decayed alone",
    )


def _unless_ignored(field: str) -> _Reader:
    rules = rules_where(lambda rule: field in rule.ignores)
    return _Reader(
        lambda setup: setup.scenario.rule not in rules, f"all rules but {_listed(rules)}"
    )


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last


_AT_CONTENTION = _Reader(
    lambda setup: has_contenders(setup.scenario, setup.neighbours),
    "--schedule hybrid, hybrid-leaves or dynamic alone",
)
_READERS = {
    "weights": _of_rules(rules_where(lambda rule: "weights" not in rule.ignores)),
    "arbiter": _AT_CONTENTION,
    "trigger": _AT_CONTENTION,
    "decay": _of_decayed("decay"),
    "determinant_weights": _of_decayed("determinant_weights"),
    "number": _unless_ignored("number"),
    "latch_delay_us": _Reader(lambda setup: setup.scenario.relay, "--relay True alone"),
    **{field: _of_rules(rules) for field, rules in rules_by_own_field().items()},
}
