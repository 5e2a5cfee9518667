"""Declarations of options: a field states its type, unit, range and help once, where it lives.

The command line, sweep axes, `set` commands and the options table of the documentation are
generated from these declarations (`concord.scenarios.types.declarations`).
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import msgspec

USER = "FILE.py:NAME"
"""The name of a value that the user brings."""


class Choice(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several values of an option, chosen by its name; its fields are options in turn."""

    @property
    def name(self) -> str:
        """The name that chooses this value on the command line."""
        return name_of(type(self))

    @classmethod
    def made_of(cls, asked: object) -> "Choice | None":
        """The value of this class that a user's file or object stands for; None if it is none."""
        return None

    @classmethod
    def summary(cls) -> str:
        """The first sentence of the documentation of this value."""
        return " ".join((cls.__doc__ or "").split("\n\n")[0].split())


def name_of(choice: type[msgspec.Struct]) -> str:
    """The name that chooses values of a class."""
    return str(choice.__struct_config__.tag)


class Option(NamedTuple):
    """Declaration of a field beside its type and default.

    Attributes:
        text: what the option means, for the help and the documentation.
        unit: unit of its number.
        group: heading in the help; that of the value which owns the field when left out.
        needs: the flag of the same value without which the option means nothing.
        flag: name of the option where it is not that of the field.
        above, at_least, below, at_most: range of its number.
        even: whether the number must be even.
        is_setting: whether a network that runs can change it (`set`).
        cure: what to do about a value outside the range or the names, and why.
        first: whether the short help of a command shows it.
    """

    text: str = ""
    unit: str = ""
    group: str = ""
    needs: str = ""
    flag: str = ""
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    even: bool = False
    is_setting: bool = False
    cure: str = ""
    first: bool = False

    def holds(self, number: float) -> bool:
        """Whether a number is finite and in the range."""
        return (
            math.isfinite(number)
            and (self.above is None or number > self.above)
            and (self.at_least is None or number >= self.at_least)
            and (self.below is None or number < self.below)
            and (self.at_most is None or number <= self.at_most)
            and (not self.even or number % 2 == 0)
        )

    @property
    def range(self) -> str:
        """Return the condition on a number, in words."""
        even = "even, " if self.even else ""
        match self.above, self.at_least, self.below, self.at_most:
            case None, None, None, None:
                return "finite"
            case None, 0, None, None:
                return even + "0 or more"
            case None, least, None, None:
                return even + f"at least {least:g}"
            case above, None, None, None:
                return even + f"above {above:g}"
            case None, least, below, None if below is not None:
                return even + f"at least {least:g} and below {below:g}"
            case None, int(least), None, int(most) if least != 0:
                return even + f"{least} to {most}"
        opening = f"[{self.at_least:g}" if self.above is None else f"({self.above:g}"
        closing = f"{self.at_most:g}]" if self.below is None else f"{self.below:g})"
        return f"{even}in {opening}, {closing}"


def require_kind(name: str, value: object, kinds: Any, must: str) -> None:
    """Refuse an argument of a wrong type, in words.

    Raises:
        ValueError: naming the argument, its value and what it must be.
    """
    if not isinstance(value, kinds) or isinstance(value, bool):
        shown = " ".join(repr(value).split())
        shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
        raise ValueError(f"{name} {shown} of type {type(value).__name__}: must be {must}")


_FLAG = re.compile(r"--([a-z][a-z0-9-]*)")


@contextmanager
def python_words() -> Iterator[None]:
    """Raise a ValueError with `window_steps` where its message has `--window-steps`."""
    try:
        yield
    except ValueError as error:
        text = _FLAG.sub(lambda flag: flag[1].replace("-", "_"), str(error))
        raise ValueError(text) from error
