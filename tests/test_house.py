"""The product keeps the house rules, and each rule finds a violation that is planted here.

`python -m tests.house` prints what breaks them.
"""

import pytest

from tests.conftest import LONGEST, ROOT
from tests.house import dead_code, structure
from tests.house.dead_code import functions_are_called, modules_are_reached
from tests.house.features import (
    entries_import_nothing,
    features_need_what_they_name,
    the_core_names_no_feature,
)
from tests.house.names import aliases_have_one_definition, class_names_are_unique
from tests.house.rules import RULES, Rule
from tests.house.sizes import budget_findings, budgets, called_once, counted
from tests.house.sources import Source, product
from tests.house.structure import (
    classes_are_small,
    folders_are_small,
    no_import_circles,
    small_files_have_a_reason,
)

pytestmark = pytest.mark.usefixtures("_trees_are_dropped")

UPWARDS = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from concord.bus.b import B"
LAZY = "def f():\n    import concord.bus.a"
DYNAMIC = "import importlib\nimportlib.import_module('concord.bus.a')"
BIG = "class Big:\n" + "    x = 1\n" * structure.MOST_CLASS_LINES
STRING = "MODULE = 'concord.bus.b:START'"
FORMATTED = "_ALL = 'concord.features'\nPLANT = f'{_ALL}.car.plant:PLANT'"
SMALL = "x = 1\n" * (structure.LEAST_LINES - 1)
REASON = f'"""A plant.\n\nReason for a file of its own: it is a template.\n"""\n{SMALL[:60]}'
NO_NEEDS = {"features/car/entries.py": "", "features/sets/entries.py": ""}
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
    (no_import_circles, {"bus/a.py": STRING, "bus/b.py": "import concord.bus.a"}, "2 files"),
    (
        folders_are_small,
        {f"bus/a{number}.py": "" for number in range(structure.MOST_FILES + 1)},
        "bus/: 26 files",
    ),
    (classes_are_small, {"bus/a.py": BIG}, "bus/a.py:1: class Big has 201 lines"),
    (small_files_have_a_reason, {"bus/a.py": SMALL, "bus/__init__.py": LAZY}, "39 lines and 1"),
    (the_core_names_no_feature, {"nodes/a.py": "import concord.papers"}, "a.py:1: the core names"),
    (the_core_names_no_feature, {"concord/a.py": FORMATTED}, "2: the core names concord.features"),
    (the_core_names_no_feature, {"bus/entries.py": FORMATTED}, "names concord.features.car.plant"),
    (the_core_names_no_feature, {"bus/a.py": "x = 'see features/car'"}, "names features/car"),
    (
        features_need_what_they_name,
        {**NO_NEEDS, "features/sets/a.py": "import concord.features.car.plant"},
        "features/sets/a.py:1: features/sets/ names features/car/",
    ),
    (
        features_need_what_they_name,
        {**NO_NEEDS, "features/sets/entries.py": FORMATTED},
        "features/sets/entries.py:2",
    ),
    (
        features_need_what_they_name,
        {"features/sets/entries.py": "NEEDS = ('car',)"},
        "car, which is no feature",
    ),
    (features_need_what_they_name, {"features/sets/a.py": ""}, "features/sets/: has no entries.py"),
    (entries_import_nothing, {"features/car/entries.py": "import math"}, "1: imports math"),
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
    (no_import_circles, {"bus/entries.py": STRING, "bus/b.py": "import concord.bus.entries"}),
    (small_files_have_a_reason, {"bus/a.py": f"{SMALL}x = 1\n"}),
    (small_files_have_a_reason, {"bus/a.py": REASON, "bus/entries.py": "", "bus/__init__.py": ""}),
    (
        small_files_have_a_reason,
        {"bus/a.py": SMALL, "bus/entries.py": DYNAMIC, "bus/__init__.py": LAZY},
    ),
    (the_core_names_no_feature, {"features/car/a.py": FORMATTED, "docs/a.py": FORMATTED}),
    (the_core_names_no_feature, {"concord/a.py": "GROUP = 'concord.features'"}),
    (
        features_need_what_they_name,
        {**NO_NEEDS, "features/sets/entries.py": f"NEEDS = ('car',)\n{FORMATTED}"},
    ),
    (entries_import_nothing, {"studies/compare/entries.py": "import math"}),
    (class_names_are_unique, {"bus/a.py": "class _F: pass", "nodes/a.py": "class _F: pass"}),
    (aliases_have_one_definition, {"bus/a.py": "LEAST = a.b", "nodes/a.py": "LEAST = a.b"}),
    (modules_are_reached, {"launch_local.py": "START = 'concord.bus.a'", "bus/a.py": ""}),
    (modules_are_reached, {"bus/entries.py": STRING, "bus/b.py": ""}),
    (functions_are_called, {"bus/a.py": "def lonely(): pass", "bus/b.py": "a.lonely()"}),
    (
        functions_are_called,
        {"bus/a.py": "def lonely(): pass", "bus/entries.py": "X = 'concord.bus.a:lonely'"},
    ),
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
    (found,) = rule([Source(path, text) for path, text in files.items()])
    assert complaint in found


@pytest.mark.parametrize(("rule", "files"), ALLOWED)
def test_allowed_files_pass(rule: Rule, files: dict[str, str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(dead_code, "pages", lambda: "")
    assert not list(rule([Source(path, text) for path, text in files.items()]))


def test_a_page_makes_a_function_public(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(dead_code, "pages", lambda: "call `lonely` to begin")
    assert not list(functions_are_called([Source("bus/a.py", "def lonely(): pass")]))


def test_every_rule_has_a_planted_violation():
    assert {rule for rule, *_ in PLANTED} == set(RULES)


def test_folders_keep_their_budgets():
    if found := list(budget_findings(counted(), budgets())):
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize(
    ("lines", "budget", "says"),
    [
        ({"bus": 101}, {"bus": 100}, "bus: 101 lines, at most 100"),
        ({"bus": 97}, {"bus": 100}, "lower the budget"),
        ({"bus": 1}, {}, "no budget"),
        ({}, {"bus": 100}, "0 lines and a budget of 100"),
    ],
)
def test_a_budget_that_is_not_kept_is_found(
    lines: dict[str, int], budget: dict[str, int], says: str
):
    (found,) = budget_findings({"source": {}, "tests": lines}, {"source": {}, "tests": budget})
    assert says in found


def test_a_budget_that_is_kept_passes():
    counts = {"source": {"bus": 98}, "tests": {"bus": 100}}
    assert not list(budget_findings(counts, {"source": {"bus": 100}, "tests": {"bus": 100}}))


def test_short_private_functions_that_are_called_once_are_counted():
    text = "def _a(): pass\ndef _b(): pass\ndef c(): pass\n_a(), _b(), _b(), c()"
    assert [function.name for function in called_once(Source("bus/a.py", text))] == ["_a"]


def test_the_files_that_begin_first_are_there():
    assert all((ROOT / "tests" / f"{name}.py").is_file() for name in LONGEST)
