"""What to answer when a name is not known."""

import difflib
from collections.abc import Iterable


def unknown_name(kind: str, name: str, names: Iterable[str]) -> ValueError:
    """The error for a `name` of a `kind` that is none of `names`: it offers the nearest."""
    names = tuple(names)
    nearest = difflib.get_close_matches(name, names, n=1, cutoff=0.0)[0]
    return ValueError(
        f"unknown {kind} {name!r}: did you mean {nearest!r}? Valid names are {', '.join(names)}"
    )
