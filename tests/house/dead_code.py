"""Rules against dead code: no module, public function or public method is used by tests alone."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

from tests.house.sources import ROOT, Source, imported_modules, named_modules

# Entry points: files that a user, the Makefile or another process starts by name.
_STARTED = re.compile(
    r"(.*/__main__|launch_local|concord/.*|papers/\w+/reproduce|benchmarks/.*|docs/.*|examples/.*)\.py"
)
# A class with another base may have methods that the library of this base calls.
_PLAIN_BASES = {"NamedTuple", "Protocol", "Generic", "Struct", "msgspec.Struct", "ValueError"}


def pages() -> str:
    """Return the text of all pages and scripts that name public functions to users."""
    names = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*")]
    names += [ROOT / "pyproject.toml", ROOT / "Makefile", *ROOT.glob("docs/*.py")]
    return "\n".join(file.read_text(encoding="utf-8") for file in names if file.is_file())


def modules_are_reached(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse a module that no command, benchmark, page or script reaches."""
    by_name = {file.module: file for file in sources}
    names_on_pages = _dotted_names(pages())
    reached = set[str]()
    waiting = [
        file.module
        for file in sources
        if _STARTED.fullmatch(str(file.path)) or file.is_entries or file.module in names_on_pages
    ]
    # Entries and processes are started by the names of their modules, which stand in strings.
    waiting += [module for file in sources for module, _ in named_modules(file)]
    while waiting:
        module = waiting.pop()
        if module in by_name and module not in reached:
            reached.add(module)
            waiting += imported_modules(by_name[module], set(by_name))
    for file in sources:
        if file.module not in reached and file.path.name != "__init__.py":
            yield f"{file.path}:1: no command reaches this file; delete it, or make it reachable"


def _dotted_names(text: str) -> set[str]:
    """Every name of dotted words in a text, and each part of it that is such a name."""
    found = set[str]()
    for name in set(re.findall(r"\w+(?:\.\w+)*", text)):
        words = name.split(".")
        found |= {
            ".".join(words[first:last])
            for first in range(len(words))
            for last in range(first + 1, len(words) + 1)
        }
    return found


def functions_are_called(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse a public function or method that only tests call.

    Names decide: a function counts as called where its name is read anywhere in the product
    outside its own body, or stands in a page.
    """
    text = set(re.findall(r"\w+", pages()))
    uses: dict[str, list[tuple[Source, int]]] = defaultdict(list)
    definitions: list[tuple[Source, ast.FunctionDef | ast.AsyncFunctionDef]] = []
    for file in sources:
        for name, line in _uses(file):
            uses[name].append((file, line))
        if file.is_entries:
            for line, target in file.strings:
                uses[target.rpartition(":")[2]].append((file, line))
        definitions += [(file, node) for node in _public(file.tree)]
    for file, node in definitions:
        first = min(part.lineno for part in (node, *node.decorator_list))
        own = range(first, (node.end_lineno or first) + 1)
        is_used = any(user is not file or line not in own for user, line in uses[node.name])
        if node.name not in text and not is_used:
            yield (
                f"{file.path}:{node.lineno}: only tests call {node.name}; delete it, move it to "
                "the tests, or make it reachable"
            )


def _uses(file: Source) -> Iterator[tuple[str, int]]:
    yield from ((node.id, node.lineno) for node in file.nodes(ast.Name))
    yield from ((node.attr, node.lineno) for node in file.nodes(ast.Attribute))
    yield from ((node.arg, node.lineno) for node in file.nodes(ast.keyword) if node.arg)
    for node in file.nodes(ast.Constant):
        if isinstance(node.value, str) and node.value.isidentifier():
            yield node.value, node.lineno


def _public(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield public functions, and public methods of classes that no library calls."""
    for node in tree.body:
        body: Sequence[ast.stmt] = [node]
        if isinstance(node, ast.ClassDef):
            bases = {ast.unparse(base).partition("[")[0] for base in node.bases}
            body = node.body if bases <= _PLAIN_BASES else []
        for child in body:
            is_function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            if is_function and not child.name.startswith("_"):
                yield child
