"""Names of the graphs and weights, without their code, and the error for a name that is unknown.

Apart from the functions that make them, which bring scipy and networkx.
"""

import difflib
from collections.abc import Iterable
from typing import TypeGuard

from concord.entries import entries

# K stands for a number, PATH for a file of `graph_files`.
_GRAPHS = (
    "ring",
    "path",
    "star",
    "grid",
    "complete",
    "erdos-renyi",
    "small-world",
    "scale-free",
    "K-regular",
    "geometric",
    "edges:0-1;1-2",
    "file:PATH",
    "directed:PATH",
)
WEIGHTS = ("metropolis", "maximum-degree", "best-constant", "fastest-mixing", "equal-neighbour")


def graph_names() -> tuple[str, ...]:
    """Return the names of all graphs, those of entries last."""
    return (*_GRAPHS, *entries("GRAPHS"))


def is_file_name(graph: object) -> TypeGuard[str]:
    """Return whether a graph is a name that says a file of its own."""
    return isinstance(graph, str) and graph.startswith(("file:", "directed:"))


def unknown_name(kind: str, name: str, names: Iterable[str]) -> ValueError:
    """Return the error for a `name` of a `kind` that is not in `names`; it offers a near one."""
    names = tuple(names)
    near = difflib.get_close_matches(name, names, n=1)
    offer = f": did you mean {near[0]!r}?" if near else "."
    if name.endswith(".py"):
        offer = f": a file is given with a name in it, {name}:NAME."
    return ValueError(f"unknown {kind} {name!r}{offer} Valid names are {', '.join(names)}")
