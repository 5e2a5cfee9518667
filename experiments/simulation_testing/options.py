"""Command-line options of simulation testing: fields of the scenario, seeds and the wire."""

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Any

import msgspec

from concord.experiments.scenario_flags import grouped_flags, texts
from concord.experiments.simulation_testing.wire import read_wire
from concord.scenarios.scenario_options import offered_options

if TYPE_CHECKING:

    class FixedOptions:
        """A text or None for each field of a case."""

else:
    FixedOptions = grouped_flags(
        "FixedOptions",
        "What is the same in all cases; everything else is drawn from the seed.",
        texts("VALUE", left_out="(drawn from the seed, or the scenario's default)"),
        without=("run",),
    )


def fixed_fields(asked: Mapping[str, str]) -> dict[str, Any]:
    """Return the values that texts mean, by the fields of a case.

    Raises:
        ValueError: a text that means no value of its field, or no fault.
    """
    fixed: dict[str, Any] = {}
    for name, text in asked.items():
        if name in ("changes", "wire"):
            fixed[name] = tuple(part.strip() for part in text.split(",") if part.strip())
            continue
        kind = reduce(or_, offered_options()[name].kinds)
        try:
            fixed[name] = msgspec.convert(text, kind, strict=False)
        except msgspec.ValidationError as error:
            raise ValueError(f"--{name.replace('_', '-')} {text}: {error}") from None
    read_wire(fixed.get("wire", ()))
    return fixed


def read_seeds(text: str) -> range:
    """Return the seeds of "1..1000", or the one of "17".

    Raises:
        ValueError: it names none.
    """
    first, dots, last = text.partition("..")
    numbers = [part for part in (first, last if dots else first)]
    if not all(number.isdecimal() for number in numbers) or int(numbers[0]) > int(numbers[1]):
        raise ValueError(f"--seeds {text}: must be a number, or two as in 1..1000, the lower first")
    return range(int(numbers[0]), int(numbers[1]) + 1)
