"""The house rules of ARCHITECTURE.md and CONTRIBUTING.md as tests.

Each rule is a function from one parsed file to complaints that say what to do instead. A small
planted violation below shows that each rule can fail.
"""

import ast
import re
from collections.abc import Callable, Iterator

import pytest

from tests.house.sources import PACKAGES, ROOT, Source, packages, product

pytestmark = pytest.mark.usefixtures("_trees_are_dropped")
MAX_FUNCTION_LINES = 70

# Each folder may import what is to the left of it; `concord.entries` is below all of them.
MATHEMATICS = {"filters", "topology", "bus", "plants"}
SCENARIOS = MATHEMATICS | {"nodes", "scenarios"}
STUDIES = SCENARIOS | {"runtime", "results", "studies"}
MAY_IMPORT: dict[str, set[str]] = {
    "filters": set(),
    "topology": set(),
    "bus": set(),
    "plants": set(),
    "nodes": {"filters", "bus"},
    "scenarios": SCENARIOS - {"scenarios"},
    "runtime": SCENARIOS,
    "results": SCENARIOS | {"runtime"},
    "studies": STUDIES - {"studies"},
    "dashboard": STUDIES,
    "experiments": STUDIES | {"dashboard"},
    "features": STUDIES | {"dashboard", "experiments"},
    "papers": STUDIES | {"experiments", "features"},
    "benchmarks": STUDIES | {"dashboard", "experiments", "features", "launch_local", "papers"},
    "launch_local": {"experiments"},
    "concord": STUDIES | {"experiments"},
}
# Each of these libraries may be imported only in its own files.
WALLS = {
    "zenoh": r"runtime/network/zenoh_transport\.py",
    "viser": r"dashboard/.*|features/\w+/(?:scene|charts)\.py",
}
SERIALISERS = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
CLOCKS_AND_CHANCE = {"time", "datetime", "random", "secrets", "uuid"}
PURE = (
    "filters/", "topology/", "bus/", "plants/", "nodes/node.py", "nodes/environment.py",
    "nodes/vector_codec.py", "nodes/messages.py", "runtime/in_process.py", "concord/entries.py",
)  # fmt: skip
SEEDED = {"Generator", "SeedSequence", "BitGenerator", "PCG64", "Philox", "default_rng"}
SPEAKERS = (
    r"experiments/.*|benchmarks/.*|runtime/processes/launcher.*|papers/reproduce.*"
    r"|features/\w+/(?:commands/.*|\w*commands?\.py|up\.py)"
)
MARKERS = re.compile("|".join((r"\bTO" + "DO\\b", r"\bFIX" + "ME\\b", r"\bX" + "XX\\b")))


# --- the rules ---------------------------------------------------------------------------------


def imported(file: Source) -> Iterator[tuple[int, str]]:
    """Line and full name of everything imported, inside functions too; ours without `concord.`."""
    for module, name, line in file.imports:
        full = f"{module}.{name}" if name else module
        bare = full.removeprefix("concord.")
        # A folder that is imported without `concord` would be loaded a second time.
        yield line, f".{full}" if full == bare and full.partition(".")[0] in PACKAGES else bare


def _called(call: ast.Call) -> str:
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""


def imports_point_one_way(file: Source) -> Iterator[str]:
    allowed = MAY_IMPORT.get(file.room, set()) | {file.room}
    tops = {(line, name.partition(".")[0]): name for line, name in imported(file)}
    for (line, top), name in tops.items():
        if top in ("", "tests"):
            yield f"{line}: imports {name}; name our folders as concord.FOLDER, and no tests"
        elif top in MAY_IMPORT and top not in allowed:
            yield (
                f"{line}: {file.room}/ imports {top}/, but may import only "
                f"{', '.join(sorted(allowed - {file.room})) or 'nothing of ours'}; pass the value "
                "in as an argument, or move the code to a room that may know both"
            )


def libraries_stay_behind_their_walls(file: Source) -> Iterator[str]:
    for line, name in imported(file):
        wall = WALLS.get(name.partition(".")[0])
        if wall and not re.fullmatch(wall, str(file.path)):
            yield f"{line}: imports {name}; only {wall} may, so call what that offers"


def private_names_stay_in_their_file(file: Source) -> Iterator[str]:
    for line, name in imported(file):
        last = name.rpartition(".")[2]
        if name.partition(".")[0] in MAY_IMPORT and re.match(r"_(?!_)", last):
            yield f"{line}: imports {name}; make it public with a docstring, or do without it"


def functions_are_short(file: Source) -> Iterator[str]:
    for node in file.nodes(ast.FunctionDef, ast.AsyncFunctionDef):
        lines = (node.end_lineno or node.lineno) - node.lineno + 1
        if lines > MAX_FUNCTION_LINES:
            yield (
                f"{node.lineno}: {node.name} has {lines} lines, at most {MAX_FUNCTION_LINES}; "
                "give each of its ideas a function of its own"
            )


def nothing_prints_but_the_command_line(file: Source) -> Iterator[str]:
    speaks = re.fullmatch(SPEAKERS, str(file.path))
    for node in file.nodes(ast.Call):
        if isinstance(node.func, ast.Name) and _called(node) == "print":
            yield f"{node.lineno}: print; return the text, and let experiments/ write it"
    for node in file.nodes(ast.Attribute):
        if node.attr == "stdout" and not speaks:
            yield f"{node.lineno}: standard output; return the text, and let experiments/ write it"


def nothing_is_pickled(file: Source) -> Iterator[str]:
    for line, name in imported(file):
        if name.partition(".")[0] in SERIALISERS:
            yield f"{line}: imports {name}; write JSON with msgspec, arrays with xarray"
    for node in file.nodes(ast.keyword):
        if node.arg == "allow_pickle":
            yield f"{node.value.lineno}: allow_pickle; store plain arrays"


def pure_rooms_know_no_clock_and_no_chance(file: Source) -> Iterator[str]:
    if not str(file.path).startswith(PURE):
        return
    for line, name in imported(file):
        if name.partition(".")[0] in CLOCKS_AND_CHANCE:
            yield f"{line}: imports {name}; take time and randomness as arguments"


def randomness_is_seeded(file: Source) -> Iterator[str]:
    for node in file.nodes(ast.Attribute):
        match node.value:
            case ast.Attribute(value=ast.Name(id="np" | "numpy"), attr="random") if (
                node.attr not in SEEDED
            ):
                yield f"{node.lineno}: np.random.{node.attr} is global; take a numpy Generator"
    for node in file.nodes(ast.Call):
        if _called(node) == "default_rng" and not node.args:
            yield f"{node.lineno}: a generator without a seed; take the seed as an argument"


def no_work_is_left_lying(file: Source) -> Iterator[str]:
    for number, line in enumerate(file.text.splitlines(), start=1):
        if MARKERS.search(line):
            yield f"{number}: {line.strip()!r}; do it now, or open an issue and say its number"


def modules_say_what_they_are_for(file: Source) -> Iterator[str]:
    if not ast.get_docstring(file.tree):
        yield "1: no module docstring; begin with one sentence that says what the file is for"


def public_things_have_docstrings(file: Source) -> Iterator[str]:
    for node in file.tree.body:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        if not node.name.startswith("_") and not ast.get_docstring(node):
            yield f"{node.lineno}: {node.name} has no docstring; say shapes, units, errors raised"


Rule = Callable[[Source], Iterator[str]]
EVERYWHERE: list[Rule] = [
    functions_are_short,
    libraries_stay_behind_their_walls,
    no_work_is_left_lying,
    nothing_is_pickled,
]
IN_THE_PRODUCT: list[Rule] = [
    imports_point_one_way,
    modules_say_what_they_are_for,
    nothing_prints_but_the_command_line,
    private_names_stay_in_their_file,
    public_things_have_docstrings,
    pure_rooms_know_no_clock_and_no_chance,
    randomness_is_seeded,
]


def _require(rule: Rule, sources: list[Source]) -> None:
    found = [f"{file.path}:{complaint}" for file in sources for complaint in rule(file)]
    if found:
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize("rule", EVERYWHERE, ids=lambda rule: rule.__name__)
def test_everywhere(rule: Rule):
    _require(rule, packages())


@pytest.mark.parametrize("rule", IN_THE_PRODUCT, ids=lambda rule: rule.__name__)
def test_in_the_product(rule: Rule):
    _require(rule, product())


# --- the rules themselves ----------------------------------------------------------------------

LONG_FUNCTION = "def f():\n" + "    x = 1\n" * MAX_FUNCTION_LINES
LONG_METHOD = "class C:\n    async " + LONG_FUNCTION.replace("\n", "\n    ")
LAZY = "def f():\n    from concord.scenarios import build"
HIDDEN = "import importlib\nimportlib.import_module('concord.bus.flexray.frame')"
VIOLATIONS: list[tuple[Rule, str, str, str]] = [
    (imports_point_one_way, "filters/a.py", "import concord.plants", "pass the value in"),
    (
        imports_point_one_way,
        "bus/a.py",
        "from concord.nodes.messages import Bid",
        "nothing of ours",
    ),
    (imports_point_one_way, "nodes/a.py", LAZY, "2: nodes/ imports scenarios/"),
    (imports_point_one_way, "nodes/a.py", "from . import share", "as concord.FOLDER"),
    (imports_point_one_way, "nodes/a.py", "import filters.ukf", "as concord.FOLDER"),
    (imports_point_one_way, "plants/a.py", HIDDEN, "plants/ imports bus/"),
    (
        imports_point_one_way,
        "launch_local.py",
        "import concord.nodes.environment",
        "only experiments",
    ),
    (imports_point_one_way, "experiments/a.py", "import tests.conftest", "and no tests"),
    (
        libraries_stay_behind_their_walls,
        "runtime/processes/node/process.py",
        "import zenoh",
        "zenoh_transport",
    ),
    (libraries_stay_behind_their_walls, "experiments/a.py", "from viser import X", "dashboard/"),
    (libraries_stay_behind_their_walls, "features/sets/a.py", "import viser", "scene"),
    (
        imports_point_one_way,
        "results/a.py",
        "import concord.studies.memory",
        "results/ imports studies/",
    ),
    (imports_point_one_way, "dashboard/a.py", "import concord.experiments", "dashboard/ imports"),
    (imports_point_one_way, "studies/a.py", "import concord.features.sets", "studies/ imports"),
    (imports_point_one_way, "bus/a.py", "MAIN = 'concord.nodes.node:step'", "bus/ imports nodes/"),
    (
        private_names_stay_in_their_file,
        "nodes/a.py",
        "from concord.nodes.b import _f",
        "make it public",
    ),
    (functions_are_short, "filters/a.py", LONG_FUNCTION, "71 lines"),
    (functions_are_short, "filters/a.py", LONG_METHOD, "2: f has 71"),
    (nothing_prints_but_the_command_line, "nodes/a.py", "print(1)", "let experiments/"),
    (nothing_prints_but_the_command_line, "experiments/a.py", "print(1)", "let experiments/"),
    (nothing_prints_but_the_command_line, "nodes/a.py", "sys.stdout.write('')", "1: standard"),
    (nothing_is_pickled, "nodes/a.py", "def f():\n    import pickle", "msgspec"),
    (nothing_is_pickled, "plants/a.py", "np.load(f, allow_pickle=True)", "plain arrays"),
    (pure_rooms_know_no_clock_and_no_chance, "nodes/environment.py", "import time", "as arguments"),
    (pure_rooms_know_no_clock_and_no_chance, "bus/a.py", "from random import x", "as arguments"),
    (randomness_is_seeded, "plants/a.py", "np.random.normal()", "Generator"),
    (randomness_is_seeded, "plants/a.py", "rng = np.random.default_rng()", "without a seed"),
    (no_work_is_left_lying, "bus/a.py", "x = 1  # TO" + "DO: more", "open an issue"),
    (modules_say_what_they_are_for, "bus/a.py", "x = 1", "one sentence"),
    (public_things_have_docstrings, "bus/a.py", "def f(): pass", "f has no docstring"),
    (public_things_have_docstrings, "bus/a.py", "class C:\n    x = 1", "C has no docstring"),
]
DOWNWARDS = "import concord.filters.ukf\nfrom concord.nodes import share\nimport numpy"
HARMLESS: list[tuple[Rule, str, str]] = [
    (imports_point_one_way, "nodes/a.py", DOWNWARDS),
    (imports_point_one_way, "bus/a.py", "from concord.entries import chosen"),
    (imports_point_one_way, "bus/entries.py", "MAIN = 'concord.nodes.node:step'"),
    (libraries_stay_behind_their_walls, "features/sets/scene.py", "import viser"),
    (libraries_stay_behind_their_walls, "runtime/network/zenoh_transport.py", "import zenoh"),
    (private_names_stay_in_their_file, "nodes/a.py", "from concord.nodes import __version__, b"),
    (functions_are_short, "filters/a.py", LONG_FUNCTION.removesuffix("    x = 1\n")),
    (nothing_prints_but_the_command_line, "experiments/a.py", "sys.stdout.write('')"),
    (pure_rooms_know_no_clock_and_no_chance, "runtime/processes/supervisor.py", "import time"),
    (randomness_is_seeded, "plants/a.py", "np.random.default_rng(seed)"),
    (public_things_have_docstrings, "bus/a.py", "def _f(): pass"),
]


@pytest.mark.parametrize(("rule", "path", "text", "says"), VIOLATIONS)
def test_a_planted_violation_is_found(rule: Rule, path: str, text: str, says: str):
    found = list(rule(Source(path, text)))
    assert len(found) == 1
    assert says in found[0]


@pytest.mark.parametrize(("rule", "path", "text"), HARMLESS)
def test_what_is_allowed_passes(rule: Rule, path: str, text: str):
    assert not list(rule(Source(path, text)))


def test_every_rule_has_a_planted_violation():
    assert {rule for rule, *_ in VIOLATIONS} == {*EVERYWHERE, *IN_THE_PRODUCT}


def test_the_files_are_found():
    rooms = {file.room for file in packages()}
    assert {"filters", "nodes", "experiments", "tests", "launch_local"} <= rooms


# --- the page ----------------------------------------------------------------------------------


def _table_of_rooms() -> dict[str, str]:
    """Room and what it may import, in the words of ARCHITECTURE.md."""
    page = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)(?:/|\.py)` \|[^|]*\|([^|]*)\|$", page, re.MULTILINE)
    return {room: cell.strip() for room, cell in rows}


def test_the_page_names_every_room():
    missing = {file.room for file in product()} - set(_table_of_rooms())
    assert not missing, f"add a row for {sorted(missing)} to the table of ARCHITECTURE.md"


def test_the_page_and_the_rule_agree():
    for room, cell in _table_of_rooms().items():
        named = set(re.findall(r"`(\w+)`", cell))
        if room != "benchmarks":  # "everything but ..."
            assert named <= MAY_IMPORT[room], f"{room}/: the page allows {named}"
        if "all" not in cell and "four" not in cell and "everything" not in cell:
            assert named == MAY_IMPORT[room], f"{room}/: the page says {cell!r}"
