"""Rules of the door for features: the core names none, and tables of entries import nothing."""

import ast
import re
from collections.abc import Iterator, Sequence

from tests.house.sources import OUTSIDE_THE_CORE, Source

# A feature or a paper, as an import, a path or a target of an entry names it.
_OF_NO_CORE = re.compile(r"concord\.features\.\w|concord\.papers\b|\bfeatures/\w")


def the_core_names_no_feature(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse a feature or a paper in the core, as an import or in a string."""
    for file in sources:
        if file.room in OUTSIDE_THE_CORE:
            continue
        named = [(line, text) for line, text in file.strings if _OF_NO_CORE.search(text)]
        for module, name, line in file.imports:
            if _OF_NO_CORE.match(f"{module}.{name}"):
                named.append((line, f"{module}.{name}".removesuffix(".")))
        for line, text in sorted({line: text for line, text in reversed(named)}.items()):
            yield (
                f"{file.path}:{line}: the core names {_shown(text)}; let the feature bring it by "
                "its entries.py, or let the scenario's definition answer"
            )


def _shown(text: str) -> str:
    return next(word for word in text.split() if _OF_NO_CORE.search(word))


def features_need_what_they_name(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse a feature that imports or names another one that its NEEDS do not list."""
    features = {file.feature for file in sources} - {""}
    needs = {file.feature: _needs(file) for file in sources if file.feature and file.is_entries}
    for feature in sorted(features - set(needs)):
        yield f"features/{feature}/: has no entries.py; write one, so that its names are found"
    for feature, needed in sorted(needs.items()):
        for other in sorted(needed - features):
            yield f"features/{feature}/entries.py:1: NEEDS {other}, which is no feature; correct it"
    for file in sources:
        allowed = {file.feature, *needs.get(file.feature, ())}
        for line, other in _other_features(file) if file.feature else ():
            if other not in allowed:
                yield (
                    f"{file.path}:{line}: features/{file.feature}/ names features/{other}/; add it "
                    "to the NEEDS of entries.py, or move what both need to the core"
                )


def _needs(file: Source) -> set[str]:
    for node in file.tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id="NEEDS")], value=value):
                return set(ast.literal_eval(value))
    return set()


def _other_features(file: Source) -> Iterator[tuple[int, str]]:
    names = {f"{module}.{name}": line for module, name, line in file.imports}
    names |= {text: line for line, text in file.strings}
    found = {
        (line, other[1])
        for name, line in names.items()
        if (other := re.match(r"concord\.features\.(\w+)", name))
    }
    yield from sorted(found)


def entries_import_nothing(sources: Sequence[Source]) -> Iterator[str]:
    """Refuse an import in a table of entries: it would be loaded with each command."""
    for file in sources:
        if file.is_entries:
            for module, _, line in file.imports:
                yield f"{file.path}:{line}: imports {module}; a table of entries has names only"
