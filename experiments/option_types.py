"""The options of a scenario as types for editors and type checkers: `scenarios/types/options.py`.

`python -m concord.experiments.options_page` writes it again after a change.
"""

from pathlib import Path
from typing import Any

from concord.scenarios.scenario_options import OfferedOption, offered_options

FILE = Path(__file__).resolve().parent.parent / "scenarios" / "types" / "options.py"
_HEAD = '''"""Options of a scenario as keywords, generated from their declarations.

`python -m concord.experiments.options_page` writes this file; change `scenarios/types/` instead.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np

from concord.filters.filter import Filter
from concord.scenarios.types.option import Choice

PLACEMENT = int | str | np.ndarray
FUNCTION = str | Choice | Callable[..., object]
FILTER = str | Choice | Filter
if TYPE_CHECKING:
    import networkx

    GRAPH = str | networkx.Graph | np.ndarray
else:
    GRAPH = object
'''
_CLASSES = {
    "ScenarioOptions": ("One value of each option.", "{}"),
    "SweptOptions": ("One value of each option, or several.", "Sequence[{0}] | np.ndarray | {0}"),
}
_OF_NAME = {
    "bus": "FUNCTION",
    "filter": "FILTER",
    "graph": "GRAPH",
    "placement": "PLACEMENT",
    "rule": "FUNCTION",
}


def text() -> str:
    """Return the whole file."""
    options = [one for one in offered_options().values() if one.name != "scenario"]
    words = [one for one in options if _has_words(one)]
    parts = [_HEAD, *(f"{_alias(one)} = {_literal(one)}\n" for one in words)]
    for name, (meaning, form) in _CLASSES.items():
        lines = [f'\n\nclass {name}(TypedDict, total=False):\n    """{meaning}"""\n\n']
        lines += [f"    {one.name}: {form.format(_type_of(one))}\n" for one in options]
        parts += lines
    return "".join(parts)


def _type_of(option: OfferedOption) -> str:
    if option.name in _OF_NAME:
        return _OF_NAME[option.name]
    if option.declaration.choices:
        return "str | Choice"
    if _has_words(option):
        return _alias(option)
    return " | ".join(map(_name_of, option.kinds))


def _has_words(option: OfferedOption) -> bool:
    return bool(option.names) and not option.declaration.choices and option.name not in _OF_NAME


def _alias(option: OfferedOption) -> str:
    return option.name.upper()


def _literal(option: OfferedOption) -> str:
    return f"Literal[{', '.join(map(repr, option.names))}]".replace("'", '"')


def _name_of(kind: Any) -> str:
    if kind is type(None):
        return "None"
    return "Sequence[str]" if kind not in (int, float, bool, str) else kind.__name__
