"""Error messages for unknown names."""

import difflib
from collections.abc import Iterable


def unknown_name(kind: str, name: str, names: Iterable[str]) -> ValueError:
    """Return the error for a `name` of a `kind` that is not in `names`; it offers a near one."""
    names = tuple(names)
    near = difflib.get_close_matches(name, names, n=1)
    offer = f": did you mean {near[0]!r}?" if near else "."
    if name.endswith(".py"):
        offer = f": a file is given with a name in it, {name}:NAME."
    return ValueError(f"unknown {kind} {name!r}{offer} Valid names are {', '.join(names)}")
