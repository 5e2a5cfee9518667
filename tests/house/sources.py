"""The product's files as the house rules see them: module name, path, syntax tree, imports."""

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
# Folders that are packages below `concord`, by links.
PACKAGES = {link.name for link in ROOT.glob("concord/*") if link.is_symlink()}


class Source(NamedTuple):
    """One file: its path below the root, and its syntax tree."""

    path: PurePosixPath
    tree: ast.Module

    @property
    def module(self) -> str:
        """The name by which other files import this one."""
        name = ".".join(self.path.with_suffix("").parts).removesuffix(".__init__")
        return f"concord.{name}" if self.path.parts[0] in PACKAGES else name


def source(path: str, text: str) -> Source:
    """Return a file with this path and text."""
    return Source(PurePosixPath(path), ast.parse(text))


@cache
def product() -> list[Source]:
    """Return every Python file of the repository's packages but the tests."""
    files = [file for file in sorted(ROOT.glob("*.py"))]
    for entry in sorted(ROOT.iterdir()):
        if entry.name != "tests" and (entry / "__init__.py").is_file():
            files += sorted(entry.rglob("*.py"))
    return [
        source(file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8"))
        for file in files
    ]


def imported_names(tree: ast.AST) -> Iterator[tuple[str, str, int]]:
    """Yield module, name ("" for a whole module) and line of each import, also a hidden one.

    Imports under TYPE_CHECKING and inside functions count as those at the top of a file do.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "", node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((node.module, alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.Call) and _is_import(node.func) and node.args:
            argument = node.args[0]
            if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                yield argument.value, "", node.lineno


def _is_import(function: ast.expr) -> bool:
    return ast.unparse(function) in ("__import__", "import_module", "importlib.import_module")


def imported_modules(file: Source, modules: Sequence[str] | set[str]) -> dict[str, int]:
    """Return those of `modules` that a file imports, each with the line of its first import."""
    found: dict[str, int] = {}
    for module, name, line in imported_names(file.tree):
        submodule = f"{module}.{name}"
        target = submodule if submodule in modules else module
        if target in modules and target != file.module:
            found.setdefault(target, line)
    return found
