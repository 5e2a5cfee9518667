"""Error messages for unknown names."""

import difflib
from collections.abc import Iterable


def unknown_name(kind: str, name: str, names: Iterable[str]) -> ValueError:
    """Return the error for a `name` of a `kind` that is not in `names`; it offers the nearest."""
    names = tuple(names)
    nearest = difflib.get_close_matches(name, names, n=1, cutoff=0.0)[0]
    return ValueError(
        f"unknown {kind} {name!r}: did you mean {nearest!r}? Valid names are {', '.join(names)}"
    )
