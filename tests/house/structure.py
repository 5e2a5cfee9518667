"""Rules of structure: no import circles, no crowded folders, no large classes."""

import ast
from collections import Counter
from collections.abc import Iterator, Sequence

import networkx

from tests.house.sources import Source, imported_modules

MOST_FILES, MOST_CLASS_LINES = 25, 200


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
        for node in ast.walk(file.tree):
            if isinstance(node, ast.ClassDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > MOST_CLASS_LINES:
                    yield (
                        f"{file.path}:{node.lineno}: class {node.name} has {lines} lines, at most "
                        f"{MOST_CLASS_LINES}; split it by idea"
                    )
