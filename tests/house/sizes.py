"""Sizes of the house: lines of each folder beside its budget, and the table of sizes."""

import ast
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.house.sources import OUTSIDE_THE_CORE, ROOT, Source, product, tracked
from tests.house.structure import LEAST_LINES, small_files

BUDGET = ROOT / "tests" / "house" / "budget.toml"
# A budget so much above the count does not hold the next line back.
_SLACK = 1.03
_MOST_PRIVATE_LINES = 6

Lines = dict[str, dict[str, int]]
"""Lines by "source" or "tests", then by folder."""


def counted() -> Lines:
    """Count the lines of source and of tests in each folder, each feature for itself."""
    lines: dict[str, Counter[str]] = {"source": Counter(), "tests": Counter()}
    for file in tracked():
        path = file.relative_to(ROOT)
        is_test = path.parts[0] == "tests"
        lines["tests" if is_test else "source"][_folder(path, is_test)] += _lines(file)
    return {kind: dict(sorted(folders.items())) for kind, folders in lines.items()}


def _folder(path: Path, is_test: bool) -> str:
    """Return the folder whose budget counts a file; files beside the folders count together."""
    folders = path.parts[1:-1] if is_test else path.parts[:-1]
    return "/".join(folders[: 2 if folders[:1] == ("features",) else 1]) or "."


def _lines(file: Path) -> int:
    return file.read_bytes().count(b"\n")


def budgets() -> Lines:
    """Read the budget of each folder."""
    return tomllib.loads(BUDGET.read_text(encoding="utf-8"))


def budget_findings(lines: Lines, allowed: Lines) -> Iterator[str]:
    """Yield each folder that has no budget, exceeds it, or has one far above its count."""
    for kind in ("source", "tests"):
        for folder in sorted({*lines[kind], *allowed[kind]}):
            count, budget = lines[kind].get(folder, 0), allowed[kind].get(folder)
            if budget is None:
                yield f"{kind} of {folder}: {count} lines and no budget; give it one"
            elif count > budget:
                yield (
                    f"{kind} of {folder}: {count} lines, at most {budget}; make it smaller, or "
                    "raise the budget in a commit that says which user gets what for it"
                )
            elif budget > count * _SLACK:
                yield (
                    f"{kind} of {folder}: {count} lines and a budget of {budget}; lower the "
                    "budget: python -m tests.house --set-budget"
                )


def set_budgets() -> None:
    """Write the present count of each folder as its budget; the head of the file stays."""
    head = BUDGET.read_text(encoding="utf-8").partition("\n[source]\n")[0]
    tables = "".join(
        f"\n[{kind}]\n" + "".join(f'"{folder}" = {count}\n' for folder, count in folders.items())
        for kind, folders in counted().items()
    )
    BUDGET.write_text(f"{head}{tables}", encoding="utf-8")


def table() -> Iterator[str]:
    """Yield the lines of the table of sizes, then those of each folder."""
    lines, sources = counted(), product()
    files = [file for file in tracked() if file.relative_to(ROOT).parts[0] != "tests"]
    top = Counter[str]()
    for folder, count in lines["source"].items():
        top[folder.partition("/")[0]] += count
    rows: Mapping[str, int] = {
        f"all source, in {len(files)} files": top.total(),
        "core": sum(count for name, count in top.items() if name not in OUTSIDE_THE_CORE),
        "features": top["features"],
        "papers": top["papers"],
        "tests with the laboratory": sum(lines["tests"].values()),
        f"files under {LEAST_LINES} lines": len(small_files(sources)),
        f"private functions called once, of at most {_MOST_PRIVATE_LINES} lines": sum(
            1 for file in sources for _ in called_once(file)
        ),
    }
    yield from (f"{count:8,}  {name}" for name, count in rows.items())
    for kind, folders in lines.items():
        yield from ("", f"{kind} by folder")
        yield from (f"{count:8,}  {folder}" for folder, count in folders.items())


def called_once(file: Source) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the short private functions and methods that their file names exactly once."""
    uses = Counter(node.id for node in file.nodes(ast.Name))
    uses.update(node.attr for node in file.nodes(ast.Attribute))
    for node in file.nodes(ast.FunctionDef, ast.AsyncFunctionDef):
        lines = (node.end_lineno or node.lineno) - node.lineno + 1
        is_private = node.name.startswith("_") and not node.name.startswith("__")
        if is_private and uses[node.name] == 1 and lines <= _MOST_PRIVATE_LINES:
            yield node
