"""Rules of names: a public class and a type alias have one place in the product."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

from tests.house.sources import Source

_ALIAS = re.compile(r"_*[A-Z]\w*[a-z]\w*")


def class_names_are_unique(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse two public classes of one name."""
    places: dict[str, list[str]] = defaultdict(list)
    for file in sources:
        for node in file.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(f"{file.path}:{node.lineno}")
    for name, found in sorted(places.items()):
        if len(found) > 1:
            yield f"class {name} is defined {len(found)} times: {', '.join(found)}; name each"


def aliases_have_one_definition(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse a type alias that is defined in two files."""
    places: dict[str, list[str]] = defaultdict(list)
    for file in sources:
        for name, line in _aliases(file.tree):
            places[name.lstrip("_")].append(f"{file.path}:{line}")
    for name, found in sorted(places.items()):
        if len(found) > 1:
            yield (
                f"alias {name} is defined {len(found)} times: {', '.join(found)}; import one, or "
                "write the type"
            )


def _aliases(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                pass
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                pass
            case _:
                continue
        is_type = isinstance(value, ast.Name | ast.Attribute | ast.Subscript | ast.BinOp)
        if is_type and _ALIAS.fullmatch(name):
            yield name, node.lineno
