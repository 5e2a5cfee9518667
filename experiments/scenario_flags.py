"""The flags of a scenario, group by group, made from the declared options."""

from collections.abc import Callable, Iterator
from dataclasses import field, fields, make_dataclass
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import OfferedOption, offered_options, scenario_of
from concord.studies.memory import check_memory

GROUPS = {
    "plant": "Simulated plant.",
    "network": "Nodes and who hears whom.",
    "rule": "How nodes fuse what they hear.",
    "bus": "How shares travel.",
    "filter": "How a node filters its readings.",
    "faults": "Faults of links and processes.",
    "run": "How long, and with which randomness.",
}

_METAVARS = {int: "INT", float: "FLOAT", str: "TEXT"}
Flag = tuple[Any, Any]
"""The type of a flag and its default."""


def grouped_flags(
    name: str, says: str, flag: Callable[[OfferedOption], Flag], without: tuple[str, ...] = ()
) -> type:
    """A class with a class of flags for each group of options."""
    groups = []
    for group, meaning in GROUPS.items():
        made = [
            (one.name, *_with_default(flag(one)))
            for one in offered_options().values()
            if one.group == group and one.name not in without
        ]
        options = make_dataclass(f"{group.title()}{name}", made, frozen=True, kw_only=True)
        options.__doc__ = meaning
        kept = Annotated[options, tyro.conf.OmitArgPrefixes]
        groups.append((group, kept, field(default_factory=options)))
    found = make_dataclass(name, groups, frozen=True, kw_only=True)
    found.__doc__ = says
    return found


def said_in(flags: Any) -> dict[str, Any]:
    """Return the flags that were given, of all groups."""
    return dict(_said_in(flags))


def _said_in(flags: Any) -> Iterator[tuple[str, Any]]:
    for group in fields(flags):
        values = getattr(flags, group.name)
        for one in fields(values):
            value = getattr(values, one.name)
            if value != one.default:
                yield one.name, value


def _with_default(flag: Flag) -> tuple[Any, Any]:
    annotation, default = flag
    return annotation, field(default=default)


def _typed(option: OfferedOption) -> Flag:
    """A flag that reads one value; a truth value has --NAME and --no-NAME."""
    if option.kinds == (bool,):
        return Annotated[bool, tyro.conf.arg(help=option.help)], option.default
    kind = reduce(or_, (*option.kinds, type(None)))
    shown = tyro.conf.arg(
        help=option.help,
        metavar=_METAVARS.get(option.kinds[0], "TEXT .."),
        help_behavior_hint=option.default_in_words,
    )
    return Annotated[kind, shown], None


def texts(metavar: str, left_out: str | None = None) -> Callable[[OfferedOption], Flag]:
    """Flags that read a text each; `left_out` says in the help what holds without the flag, in
    place of the default."""

    def flag(option: OfferedOption) -> Flag:
        hint = option.default_in_words if left_out is None else left_out
        shown = tyro.conf.arg(help=option.help, metavar=metavar, help_behavior_hint=hint)
        return Annotated[str | None, shown], None

    return flag


if TYPE_CHECKING:

    class ScenarioFlags:
        """Options of a scenario that the user has given, by group."""

else:
    ScenarioFlags = grouped_flags("Options", "Simulated plant.", _typed)


def resolved(flags: ScenarioFlags) -> Scenario:
    """Return the scenario that flags mean, nothing left open.

    Raises:
        ValueError: there is no such scenario, an option that it cannot have, or more steps than
            the memory holds.
    """
    scenario = scenario_of(**said_in(flags))
    check_memory(scenario)
    return scenario
