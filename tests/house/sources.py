"""The Python files as the house rules see them: module name, path, text, syntax tree, imports."""

import ast
import gc
import re
import subprocess
from collections import defaultdict
from collections.abc import Collection, Iterator
from functools import cache, cached_property
from pathlib import Path, PurePosixPath
from typing import TypeVar

ROOT = Path(__file__).resolve().parents[2]
# Folders that are packages below `concord`, by links.
PACKAGES = {link.name for link in ROOT.glob("concord/*") if link.is_symlink()}
# The core is every folder but these.
OUTSIDE_THE_CORE = {"features", "papers", "benchmarks", "docs", "examples", "tests"}
_MODULE = re.compile(r"(concord\.\w+\.\w[\w.]*)(?::\w+)?")

_Node = TypeVar("_Node", bound=ast.AST)


class Source:
    """One file: its path below the root, its text, and what ast makes of it."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.text = PurePosixPath(path), text

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree of the file."""
        return ast.parse(self.text, str(self.path))

    @property
    def room(self) -> str:
        """The folder at the root that has the file, or the name of a file at the root."""
        return self.path.parts[0].removesuffix(".py")

    @property
    def feature(self) -> str:
        """The folder below features/ that has the file; empty elsewhere."""
        return self.path.parts[1] if self.room == "features" and len(self.path.parts) > 2 else ""

    @property
    def is_entries(self) -> bool:
        """Whether the file holds tables of names, for `concord.entries` to collect."""
        folders = 2 if self.feature else 1
        is_there = len(self.path.parts) == folders + 1 and self.path.name == "entries.py"
        return is_there and self.room != "concord"

    @property
    def module(self) -> str:
        """The name by which other files import this one."""
        name = ".".join(self.path.with_suffix("").parts).removesuffix(".__init__")
        return f"concord.{name}" if self.room in PACKAGES else name

    def nodes(self, *types: type[_Node]) -> Iterator[_Node]:
        """Yield each node of the tree that has one of the types, type by type."""
        for kind in types:
            yield from self._nodes.get(kind, ())  # pyright: ignore[reportReturnType]

    @cached_property
    def _nodes(self) -> dict[type[ast.AST], list[ast.AST]]:
        by_type: dict[type[ast.AST], list[ast.AST]] = defaultdict(list)
        # A tree has no cycles, and the collector would go through all trees again and again.
        gc.disable()
        try:
            for node in ast.walk(self.tree):
                by_type[type(node)].append(node)
        finally:
            gc.enable()
        return by_type

    @cached_property
    def strings(self) -> list[tuple[int, str]]:
        """Line and text of each string; an f-string with the file's own constants put in."""
        return list(_strings(self))

    @cached_property
    def imports(self) -> list[tuple[str, str, int]]:
        """Module, name ("" for a whole module) and line of each import, also a hidden one.

        Imports under TYPE_CHECKING and inside functions count as those at the top of a file do. A
        string that names a module of ours counts too, except in a table of entries.
        """
        return list(_imports(self))


@cache
def tracked() -> list[Path]:
    """Return every Python file that git has, or would have after `git add`."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    names = sorted(set(listing.stdout.splitlines()))
    return [ROOT / name for name in names if (ROOT / name).is_file()]


@cache
def packages() -> list[Source]:
    """Return every Python file of the repository's packages and tests."""
    return [
        Source(file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8"))
        for file in tracked()
        if file.parent == ROOT or (ROOT / file.relative_to(ROOT).parts[0] / "__init__.py").is_file()
    ]


def product() -> list[Source]:
    """Return every Python file of the repository's packages but the tests."""
    return [file for file in packages() if file.room != "tests"]


def _strings(file: Source) -> Iterator[tuple[int, str]]:
    constants: dict[str, str] = {}
    for node in file.tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant(value=str(text))):
                constants[name] = text
    inside = set[ast.AST]()
    for node in file.nodes(ast.JoinedStr):
        inside.update(node.values)
        yield node.lineno, "".join(_text(value, constants) for value in node.values)
    for node in file.nodes(ast.Constant):
        if isinstance(node.value, str) and node not in inside:
            yield node.lineno, node.value


def _text(value: ast.expr, constants: dict[str, str]) -> str:
    match value:
        case ast.Constant(value=text):
            return str(text)
        case ast.FormattedValue(value=ast.Name(id=name)):
            return constants.get(name, "{}")
    return "{}"


def _imports(file: Source) -> Iterator[tuple[str, str, int]]:
    for node in file.nodes(ast.Import):
        yield from ((alias.name, "", node.lineno) for alias in node.names)
    for node in file.nodes(ast.ImportFrom):
        origin = "." * node.level + (node.module or "")
        yield from ((origin, alias.name, node.lineno) for alias in node.names)
    for node in file.nodes(ast.Call):
        match node:
            # A module of ours is found as a string, below.
            case ast.Call(func=function, args=[ast.Constant(value=str(name)), *_]) if _is_import(
                function
            ) and not _MODULE.fullmatch(name):
                yield name, "", node.lineno
    if not file.is_entries:
        yield from ((module, "", line) for module, line in named_modules(file))


def _is_import(function: ast.expr) -> bool:
    match function:
        case ast.Name(id="__import__" | "import_module"):
            return True
        case ast.Attribute(value=ast.Name(id="importlib"), attr="import_module"):
            return True
    return False


def named_modules(file: Source) -> Iterator[tuple[str, int]]:
    """Yield module and line of each string that names a module of ours, or a member of it."""
    for line, text in file.strings:
        if found := _MODULE.fullmatch(text):
            yield found[1], line


def imported_modules(file: Source, modules: Collection[str]) -> dict[str, int]:
    """Return those of `modules` that a file imports, each with the line of its first import."""
    found: dict[str, int] = {}
    for module, name, line in file.imports:
        submodule = f"{module}.{name}"
        target = submodule if submodule in modules else module
        if target in modules and target != file.module:
            found.setdefault(target, line)
    return found
