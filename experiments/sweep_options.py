"""Every field of a scenario as an option that takes several values; made from the fields."""

import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import field, fields, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from experiments.sweep_specification import FIELDS
from scenarios.scenario import Scenario

_ATTRIBUTE = re.compile(r"^    (\w+(?:, \w+)*): (.*(?:\n        .*)*)", re.MULTILINE)


def meanings() -> dict[str, str]:
    """What each field means, in the words of `Scenario`."""
    found = {}
    for names, meaning in _ATTRIBUTE.findall(inspect.getdoc(Scenario) or ""):
        for name in names.split(", "):
            found[name] = " ".join(meaning.split())
    return {**found, "scenario": "which scenario; `concord list` names them."}


def options_of(
    name: str, names: Iterable[str], helps: Mapping[str, str], metavar: str, says: str
) -> type:
    """A class of options with a text or None for each of `names`."""
    made = [
        (one, Annotated[str | None, tyro.conf.arg(help=helps.get(one, ""), metavar=metavar,
         help_behavior_hint="")],
         field(default=None))
        for one in names
    ]  # fmt: skip
    options = make_dataclass(name, made, frozen=True, kw_only=True)
    options.__doc__ = says
    return options


if TYPE_CHECKING:

    class FieldOptions:
        """A text or None for each of `FIELDS`."""

else:
    FieldOptions = options_of(
        "FieldOptions",
        FIELDS,
        meanings(),
        "A,B,..",
        "What is swept: comma lists (ring,path) or, for whole numbers, low..high. Fields left out "
        "take the scenario's own defaults.",
    )


def asked_fields(options: Any) -> dict[str, str]:
    """The fields that were given, as they were written."""
    given = {one.name: getattr(options, one.name) for one in fields(options)}
    return {name: text for name, text in given.items() if text is not None}
