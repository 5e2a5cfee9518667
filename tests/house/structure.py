"""Rules of structure: no import circles, no crowded folders, no large classes, no crumbs."""

import ast
import re
from collections import Counter
from collections.abc import Iterator, Sequence

import networkx

from tests.house.sources import Source, imported_modules, named_modules

MOST_FILES, MOST_CLASS_LINES, LEAST_LINES = 25, 200, 40
# Python, or the collector of entries, asks for files of these names.
_GIVEN_NAMES = ("__init__.py", "__main__.py", "entries.py")
_REASON = re.compile(r"^Reason for a file of its own: \S", re.MULTILINE)


def no_import_circles(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse files that import each other, also under TYPE_CHECKING or inside functions."""
    modules = {file.module for file in sources}
    graph = networkx.DiGraph()
    lines: dict[tuple[str, str], str] = {}
    for file in sources:
        for module, line in imported_modules(file, modules).items():
            graph.add_edge(file.module, module)
            lines[file.module, module] = f"{file.path}:{line}"
    for circle in networkx.strongly_connected_components(graph):
        if len(circle) > 1:
            way = networkx.find_cycle(graph.subgraph(sorted(circle)))
            arrows = ", ".join(f"{lines[edge[0], edge[1]]} imports {edge[1]}" for edge in way)
            yield (
                f"{len(circle)} files import each other: {arrows}; move what both need to a file "
                "that imports neither"
            )


def folders_are_small(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse folders with too many files."""
    counts = Counter(file.path.parent for file in sources)
    for folder, count in sorted(counts.items()):
        if count > MOST_FILES:
            yield f"{folder}/: {count} files, at most {MOST_FILES}; sort them into folders"


def classes_are_small(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse large classes."""
    for file in sources:
        for node in file.nodes(ast.ClassDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > MOST_CLASS_LINES:
                yield (
                    f"{file.path}:{node.lineno}: class {node.name} has {lines} lines, at most "
                    f"{MOST_CLASS_LINES}; split it by idea"
                )


def small_files_have_a_reason(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse small files that fewer than two others import, unless their docstring says why."""
    modules = {file.module for file in sources}
    importers = Counter(
        module
        for file in sources
        for module in {*imported_modules(file, modules), *(name for name, _ in named_modules(file))}
        if module != file.module
    )
    for file in small_files(sources):
        if importers[file.module] < 2 and not _REASON.search(ast.get_docstring(file.tree) or ""):
            yield (
                f"{file.path}:1: {file.text.count(chr(10))} lines and {importers[file.module]} "
                "importers; join it with the file that needs it, or add a line to its docstring: "
                "Reason for a file of its own: ..."
            )


def small_files(sources: Sequence[Source]) -> list[Source]:
    """Return the files under 40 lines, but those that Python or the entries ask for by name."""
    return [
        file
        for file in sources
        if file.text.count("\n") < LEAST_LINES and file.path.name not in _GIVEN_NAMES
    ]
