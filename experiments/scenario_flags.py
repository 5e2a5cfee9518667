"""The flags of a scenario, made from the declared options, and the scenario that they mean."""

from collections.abc import Iterable
from dataclasses import field, fields, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from concord.scenarios.scenario import Scenario
from concord.scenarios.scenario_options import OfferedOption, offered_options, scenario_of
from concord.studies.memory import check_memory
from concord.studies.sweep.specification import FIELDS, value_of


def flags_of(name: str, options: Iterable[OfferedOption], listing: bool) -> type:
    """Return a class with a flag for each option.

    A flag reads a text. In a class that is not `listing`, a truth value has --NAME and --no-NAME,
    and a list of words reads several.
    """
    made = []
    for one in options:
        kind, default = str | None, None
        if not listing and one.kinds == (bool,):
            kind, default = bool, one.default
        elif not listing and one.default == ():
            kind, default = tuple[str, ...], ()
        described = Annotated[kind, tyro.conf.arg(help=one.help)]
        made.append((one.name, described, field(default=default)))
    # The help of a command reads these options where they are declared.
    namespace = {"lists_of_values": listing}
    return make_dataclass(name, made, frozen=True, kw_only=True, namespace=namespace)


def said_in(flags: Any) -> dict[str, Any]:
    """Return the flags that were given."""
    every = ((one.name, getattr(flags, one.name), one.default) for one in fields(flags))
    return {name: value for name, value, default in every if value != default}


if TYPE_CHECKING:

    class ScenarioFlags:
        """Options of a scenario that the user has given."""

    class FieldOptions:
        """Comma lists (ring,path), or low..high for whole numbers, of each option of a scenario."""

else:
    ScenarioFlags = flags_of("ScenarioFlags", offered_options().values(), listing=False)
    FieldOptions = flags_of("FieldOptions", FIELDS.values(), listing=True)


def values_in(flags: ScenarioFlags) -> dict[str, Any]:
    """Return the options that were given, as values of their types.

    Raises:
        ValueError: a text that is no number where one is needed.
    """
    return {
        name: value_of(name, value) if isinstance(value, str) else value
        for name, value in said_in(flags).items()
    }


def resolved(flags: ScenarioFlags) -> Scenario:
    """Return the scenario that flags mean, nothing left open.

    Raises:
        ValueError: there is no such scenario, an option that it cannot have, or more steps than
            the memory holds.
    """
    scenario = scenario_of(**values_in(flags))
    check_memory(scenario)
    return scenario
