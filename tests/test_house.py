"""The product keeps the house rules, and each rule finds a violation that is planted here.

`python -m tests.house` prints what breaks them.
"""

import pytest

from tests.conftest import LONGEST, ROOT
from tests.house import dead_code, structure
from tests.house.dead_code import functions_are_called, modules_are_reached
from tests.house.names import aliases_have_one_definition, class_names_are_unique
from tests.house.rules import RULES, Rule
from tests.house.sources import product, source
from tests.house.structure import classes_are_small, folders_are_small, no_import_circles

UPWARDS = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from concord.bus.b import B"
LAZY = "def f():\n    import concord.bus.a"
DYNAMIC = "import importlib\nimportlib.import_module('concord.bus.a')"
BIG = "class Big:\n" + "    x = 1\n" * structure.MOST_CLASS_LINES
LIBRARY = "import io\nclass File(io.RawIOBase):\n    def readinto(self): pass"
PLANTED: list[tuple[Rule, dict[str, str], str]] = [
    (
        no_import_circles,
        {"bus/a.py": "import concord.bus.b", "bus/b.py": "import concord.bus.a"},
        "2 files",
    ),
    (
        no_import_circles,
        {"bus/a.py": UPWARDS, "bus/b.py": LAZY},
        "bus/b.py:2 imports concord.bus.a",
    ),
    (no_import_circles, {"bus/a.py": "from concord.bus import b", "bus/b.py": DYNAMIC}, "2 files"),
    (
        no_import_circles,
        {"bus/__init__.py": "import concord.bus.a", "bus/a.py": "from concord.bus import X"},
        "imports neither",
    ),
    (
        folders_are_small,
        {f"bus/a{number}.py": "" for number in range(structure.MOST_FILES + 1)},
        "bus/: 26 files",
    ),
    (classes_are_small, {"bus/a.py": BIG}, "bus/a.py:1: class Big has 201 lines"),
    (
        class_names_are_unique,
        {"bus/a.py": "class Frame: pass", "nodes/a.py": "class Frame: pass"},
        "bus/a.py:1, nodes/a.py:1",
    ),
    (
        aliases_have_one_definition,
        {"bus/a.py": "Array = list[float]", "nodes/a.py": "_Array = np.ndarray | None"},
        "alias Array is defined 2 times",
    ),
    (
        modules_are_reached,
        {"launch_local.py": "import concord.bus.b", "bus/a.py": ""},
        "bus/a.py:1",
    ),
    (functions_are_called, {"bus/a.py": "def lonely(): lonely()"}, "only tests call lonely"),
    (functions_are_called, {"bus/a.py": "class C:\n    def lonely(self): pass"}, "bus/a.py:2"),
]
ALLOWED: list[tuple[Rule, dict[str, str]]] = [
    (no_import_circles, {"bus/a.py": "import concord.bus.b", "bus/b.py": "import numpy"}),
    (folders_are_small, {f"bus/a{number}.py": "" for number in range(structure.MOST_FILES)}),
    (classes_are_small, {"bus/a.py": BIG.removesuffix("    x = 1\n")}),
    (class_names_are_unique, {"bus/a.py": "class _F: pass", "nodes/a.py": "class _F: pass"}),
    (aliases_have_one_definition, {"bus/a.py": "LEAST = a.b", "nodes/a.py": "LEAST = a.b"}),
    (modules_are_reached, {"launch_local.py": "START = 'concord.bus.a'", "bus/a.py": ""}),
    (functions_are_called, {"bus/a.py": "def lonely(): pass", "bus/b.py": "a.lonely()"}),
    (functions_are_called, {"bus/a.py": LIBRARY}),
]


@pytest.mark.parametrize("rule", RULES, ids=lambda r: r.__name__)
def test_the_product_keeps_the_rule(rule: Rule):
    found = list(rule(product()))
    if found:
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize(("rule", "files", "complaint"), PLANTED)
def test_a_planted_violation_is_found(
    rule: Rule, files: dict[str, str], complaint: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(dead_code, "pages", lambda: "")
    (found,) = rule([source(path, text) for path, text in files.items()])
    assert complaint in found


@pytest.mark.parametrize(("rule", "files"), ALLOWED)
def test_allowed_files_pass(rule: Rule, files: dict[str, str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(dead_code, "pages", lambda: "")
    assert not list(rule([source(path, text) for path, text in files.items()]))


def test_a_page_makes_a_function_public(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(dead_code, "pages", lambda: "call `lonely` to begin")
    assert not list(functions_are_called([source("bus/a.py", "def lonely(): pass")]))


def test_every_rule_has_a_planted_violation():
    assert {rule for rule, *_ in PLANTED} == set(RULES)


def test_the_files_that_begin_first_are_there():
    assert all((ROOT / "tests" / f"{name}.py").is_file() for name in LONGEST)
