"""Collect the entries of the folders of concord, of its features and of installed packages.

An entry is a name with what stands behind it: `name: (target, summary)` or `name: (target, summary,
options)`. The target is "module:MEMBER" and is imported when the entry is chosen. The summary is
one sentence for lists and help. The options are "module:Class" of the typed value that chooses the
entry on the command line; a command has its door there, one of `DOORS`. An `entries` module holds
such tables under the names of `KINDS`, and imports nothing. A package adds a table by an entry
point of the group `concord.features`.
"""

import pkgutil
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

KINDS = {
    "SCENARIOS": "a ScenarioDefinition (docs/adding_a_scenario.md)",
    "RULES": "a Rule, or a function rule(beliefs, weights) -> belief",
    "FILTERS": "a FilterEntry",
    "RECEIVERS": "a filter that only some scenarios have",
    "BUSES": "a BusDefinition",
    "SCHEDULES": "only options: which nodes may publish in a cycle",
    "CLUSTER_FILES": "a ClusterFileFormat, by the ending of its files",
    "GRAPHS": "a GraphSource, by the word before the colon",
    "ARBITERS": "an Arbiter, or its function of urgency, beside those of the core",
    "FIGURES": "by name, (dimensions, unit, meaning) of figures of runs",
    "CHARTS": "a function (stage) -> charts of the page, beside those of the core",
    "CASES": "no target but options of a case of `concord compare`: name=value, and its runs",
    "COMMANDS": "a function of the command line, or a table of them (a group)",
    "NAMES": "a public name of the package concord",
}
"""The target of an entry, by the name of its table."""
DOORS = ("start", "study", "bus", "page", "several hosts", "packages")
"""The headings of the help; commands without a door are under the last one."""
_GROUP = "concord.features"


class Entry(NamedTuple):
    """One row of a table: see the module's text."""

    target: str
    summary: str
    options: str = ""
    door: str = DOORS[-1]


class _Source(NamedTuple):
    """A module of tables, and how messages name the package that brings it."""

    owner: str
    module: ModuleType


@cache
def entries(kind: str) -> dict[str, Entry]:
    """Return the entries of a kind by name: of folders first, then of features, then of packages.

    Raises:
        ValueError: two sources give the same name.
    """
    found: dict[str, Entry] = {}
    owners: dict[str, str] = {}
    for owner, module in _sources():
        for name, row in getattr(module, kind, {}).items():
            if name in found:
                raise ValueError(
                    f"{kind.lower()} {name!r} of {owner}: {owners[name]} has the name already; "
                    f"uninstall one of both, or rename the entry in {module.__name__}"
                )
            found[name] = Entry(*row)
            if kind == "COMMANDS" and len(row) > 2:
                found[name] = Entry(*row[:2], door=row[2])
            owners[name] = owner
    return found


def summaries(kind: str) -> dict[str, str]:
    """Return the sentence of each entry of a kind; no target is imported."""
    return {name: entry.summary for name, entry in entries(kind).items()}


def chosen(kind: str, name: str) -> Any:
    """Return what stands behind a name of a table; its module is imported now.

    Raises:
        KeyError: the table has no such name.
        ValueError: the module or its member is not there.
    """
    return member(entries(kind)[name].target)


@cache
def member(target: str) -> Any:
    """Return the member of a module, both by name: "package.module:MEMBER"; a module without one.

    Raises:
        ValueError: there is no such module, or no such member.
    """
    module_name, _, name = target.partition(":")
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{target}: {error}; install what is missing, or uninstall the package of this entry"
        ) from error
    if name and not hasattr(module, name):
        raise ValueError(f"{target}: {module_name} has no {name}; correct the entry of its package")
    return getattr(module, name) if name else module


@cache
def _sources() -> tuple[_Source, ...]:
    return (*_folders(), *_features(), *_packages())


def _folders() -> Iterator[_Source]:
    """Yield the folders of concord, links included, that have entries; the others load nothing."""
    here = Path(__file__).parent
    for found in sorted(here.glob("*/entries.py")):
        folder = found.parent.name
        yield _Source(f"concord.{folder}", import_module(f"concord.{folder}.entries"))


def _features() -> Iterator[_Source]:
    """Yield the folders below features/ whose `NEEDS`, other features, are there too."""
    package = import_module(_GROUP)
    modules = {
        found.name: import_module(f"{_GROUP}.{found.name}.entries")
        for found in pkgutil.iter_modules(package.__path__)
        if found.ispkg
    }
    for name, module in modules.items():
        if all(needed in modules for needed in getattr(module, "NEEDS", ())):
            yield _Source(f"features/{name}", module)


def _packages() -> Iterator[_Source]:
    for point in sorted(entry_points(group=_GROUP), key=lambda point: point.name):
        try:
            yield _Source(f"package {point.name}", point.load())
        except Exception as error:
            raise ValueError(
                f"package {point.name}: its entries {point.value} cannot be read ({error}); "
                "correct or uninstall it"
            ) from error
