"""Choices of an option: the typed values of all entries of a kind."""

from functools import reduce
from operator import or_
from typing import Any

import msgspec

from concord.entries import entries, member


def choice_of(
    kind: str,
    *others: type[msgspec.Struct],
    base: type[msgspec.Struct] | None = None,
) -> Any:
    """Return the union of the option classes of a kind's entries and of `others`.

    An entry without options gets a class of its own below `base`.

    Raises:
        ValueError: an entry without options, of a kind without a base.
    """
    found: list[type[msgspec.Struct]] = []
    for name, entry in entries(kind).items():
        if entry.options:
            found.append(member(entry.options))
        elif base is not None:
            made = msgspec.defstruct(
                name, [], bases=(base,), tag=name, frozen=True, kw_only=True,
                namespace={"__doc__": entry.summary},
            )  # fmt: skip
            found.append(made)
        else:
            raise ValueError(f"{kind.lower()} {name!r}: its entry names no options; add them")
    return reduce(or_, (*found, *others))
