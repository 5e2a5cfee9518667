"""What the command line says of cases of torture: fields of the scenario, seeds and the wire."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from experiments.sweep_options import meanings, options_of
from experiments.sweep_specification import FIELDS
from experiments.torture_wire import read_wire

_OWN: dict[str, Any] = {"wire": tuple[str, ...]}
_OWN_MEANINGS = {
    "wire": "what no word of --changes says, each with its probability: 'vanish 0.05, garbage 0.2, "
    "shuffle 0.5'.",
}

if TYPE_CHECKING:

    class FixedOptions:
        """A text or None for each field of a case."""

else:
    FixedOptions = options_of(
        "FixedOptions",
        [*FIELDS, *_OWN],
        {**meanings(), **_OWN_MEANINGS},
        "VALUE",
        "What is the same in all cases; everything else is drawn from the seed.",
    )


def fixed_fields(asked: Mapping[str, str]) -> dict[str, Any]:
    """The values that texts mean, by the fields of a case.

    Raises:
        ValueError: a text that means no value of its field, or no fault.
    """
    types = {**FIELDS, **_OWN}
    fixed = {}
    for name, text in asked.items():
        is_list = name in ("changes", "wire")
        value = tuple(part.strip() for part in text.split(",") if part.strip()) if is_list else text
        try:
            fixed["name" if name == "scenario" else name] = msgspec.convert(
                value, types[name], strict=False
            )
        except msgspec.ValidationError as error:
            raise ValueError(f"--{name.replace('_', '-')} {text}: {error}") from None
    read_wire(fixed.get("wire", ()))
    return fixed


def read_seeds(text: str) -> range:
    """The seeds of "1..1000", or the one of "17".

    Raises:
        ValueError: it names none.
    """
    first, dots, last = text.partition("..")
    numbers = [part for part in (first, last if dots else first)]
    if not all(number.isdecimal() for number in numbers) or int(numbers[0]) > int(numbers[1]):
        raise ValueError(f"--seeds {text}: must be a number, or two as in 1..1000, the lower first")
    return range(int(numbers[0]), int(numbers[1]) + 1)
