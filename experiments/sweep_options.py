"""Every field of a scenario as an option that takes several values; made from the fields."""

import inspect
import re
from dataclasses import field, fields, make_dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from experiments.sweep_specification import FIELDS
from scenarios.scenario import Scenario

_ATTRIBUTE = re.compile(r"^    (\w+(?:, \w+)*): (.*(?:\n        .*)*)", re.MULTILINE)


def _meanings() -> dict[str, str]:
    """What each field means, in the words of `Scenario`."""
    found = {}
    for names, meaning in _ATTRIBUTE.findall(inspect.getdoc(Scenario) or ""):
        for name in names.split(", "):
            found[name] = " ".join(meaning.split())
    return {**found, "scenario": "which scenario; `concord list` names them."}


def _options() -> type:
    meanings = _meanings()
    made = [
        (name, Annotated[str | None, tyro.conf.arg(help=meanings.get(name, ""), metavar="A,B,..",
         help_behavior_hint="")],
         field(default=None))
        for name in FIELDS
    ]  # fmt: skip
    return make_dataclass("FieldOptions", made, frozen=True, kw_only=True)


if TYPE_CHECKING:

    class FieldOptions:
        """A text or None for each of `FIELDS`."""

else:
    FieldOptions = _options()
    FieldOptions.__doc__ = (
        "What is swept: comma lists (ring,path) or, for whole numbers, low..high. Fields left out "
        "take the scenario's own defaults."
    )


def asked_fields(options: Any) -> dict[str, str]:
    """The fields that were given, as they were written."""
    given = {one.name: getattr(options, one.name) for one in fields(options)}
    return {name: text for name, text in given.items() if text is not None}
