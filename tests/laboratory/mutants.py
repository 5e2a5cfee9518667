"""Mutation testing on a random sample, with the mutants of mutmut.

mutmut changes one expression of one function at a time. A mutant that no test notices has survived.
The script takes a folder of the source and its fast tests in `tests/`, draws mutants by a seed, and
prints a table of scores and each survivor. Only drawn mutants are written (`mutant_trials`).
Statements that raise errors and lines of text are left alone: their mutants change messages.
"""

import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import unified_diff
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeVar

import tyro
from scipy.stats import binomtest

from tests.conftest import ROOT

if TYPE_CHECKING:
    import libcst
    from mutmut.mutation.file_mutation import Mutation

Drawn = TypeVar("Drawn")
FOLDERS = ("filters", "topology", "bus", "nodes", "runtime", "results", "studies")
# Commands test these folders; `tests/experiments/` holds those tests.
ALSO = {"results": ("experiments",), "studies": ("experiments",)}
LEFT_OUT = shutil.ignore_patterns(".venv", ".git", "build", "runs", "__pycache__", ".hypothesis")
# Errors, and lines that hold nothing but a piece of text.
SETTINGS = """[mutmut]
source_paths=concord
do_not_mutate_patterns=
    ^\\s*raise 
    ^\\s*f?"[^"]*"$
"""


@dataclass(frozen=True)
class MutantOptions:
    """Which folders, how many mutants, and from which seed."""

    folders: tyro.conf.Positional[tuple[str, ...]] = FOLDERS
    """Folders of the source."""
    mutants: int = 60
    """Mutants of each folder; 0 tries all, which takes days."""
    seed: int = 1
    """Which mutants are drawn."""
    tests: tuple[str, ...] = ()
    """Names of test files in `tests/FOLDER/`, such as test_bounds; all of them when left out."""
    most_s: float = 15.0
    """A mutant meets the quickest tests that reach its function, as many as take this long."""


@dataclass(frozen=True)
class Score:
    """The drawn mutants of one folder, with their statuses."""

    folder: str
    made: int
    statuses: dict[str, str]

    @property
    def counts(self) -> Counter[str]:
        """Return the number of drawn mutants of each status."""
        return Counter(self.statuses.values())

    def line(self) -> str:
        """Return a row of the table, with the interval of Wilson (1927) at 95 %."""
        drawn, caught = len(self.statuses), self.counts["caught"]
        test = binomtest(caught, drawn)
        low, high = (100 * bound for bound in test.proportion_ci(method="wilson"))
        unreached = self.counts["not reached"]
        return (
            f"| `{self.folder}/` | {self.made} | {drawn} | {caught} | {unreached} | "
            f"{drawn - caught - unreached} | {100 * caught / drawn:.0f} % "
            f"({low:.0f} to {high:.0f}) |"
        )


HEADING = (
    "| folder | mutants | drawn | caught | not reached | survived | score (95 %) |\n"
    "|---|---|---|---|---|---|---|"
)


class Mutable(NamedTuple):
    """A file of the source, and the mutants that mutmut makes of its functions."""

    path: Path
    module: "libcst.Module"
    mutants: "list[Mutation]"


def mutable(path: Path) -> Mutable:
    """Return the mutants of a file, named from the root of the project."""
    import libcst
    from mutmut.mutation.file_mutation import create_mutations

    code = path.read_text(encoding="utf-8")
    module, found, *_ = create_mutations(str(path), code)
    # Statements of a class are said to be in a function too.
    inside = [m for m in found if isinstance(m.contained_by_top_level_function, libcst.FunctionDef)]
    return Mutable(path, module, inside)


def drawn(everything: Sequence[Drawn], options: MutantOptions) -> list[Drawn]:
    """Return the mutants to try, in their order: the same ones for the same seed."""
    if not 0 < options.mutants < len(everything):
        return list(everything)
    places = random.Random(options.seed).sample(range(len(everything)), options.mutants)
    return [everything[place] for place in sorted(places)]


def written(file: Mutable, chosen: "list[Mutation]") -> dict[str, str]:
    """Write mutants into a file beside its own code; return the change of each by its name."""
    from mutmut.mutation.file_mutation import combine_mutations_to_source
    from mutmut.utils.format_utils import get_mutant_name

    made = combine_mutations_to_source(file.module, chosen)
    names = [get_mutant_name(Path("concord") / file.path, name) for name in made.mutant_names]
    before = file.module.code.splitlines(keepends=True)
    found = {}
    for name, one in zip(names, chosen, strict=True):
        after = file.module.deep_replace(one.original_node, one.mutated_node)
        lines = after.code.splitlines(keepends=True)  # pyright: ignore[reportAttributeAccessIssue]
        found[name] = "".join(unified_diff(before, lines, str(file.path), name, n=2))
    file.path.write_text(made.code, encoding="utf-8")
    return found


def places_of(folder: str, names: tuple[str, ...]) -> list[str]:
    """Return the tests that a mutant of a folder may meet."""
    if names:
        return [f"tests/{folder}/{name}.py" for name in names]
    places = [f"tests/{one}" for one in (folder, *ALSO.get(folder, ()))]
    return [place for place in places if (ROOT / place).is_dir()]


def copied(work: Path) -> None:
    """Copy the project to where its mutants are made, and go there."""
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(ROOT, work, symlinks=True, ignore=LEFT_OUT)
    (work / "setup.cfg").write_text(SETTINGS, encoding="utf-8")
    os.chdir(work)


def made(folder: str, options: MutantOptions) -> tuple[int, dict[str, str]]:
    """Write drawn mutants of a folder; return how many it has, and the change of each drawn one."""
    files = [mutable(path) for path in sorted(Path(folder).rglob("*.py"))]
    everything = [(i, one) for i, file in enumerate(files) for one in file.mutants]
    chosen, changes = drawn(everything, options), {}
    for i, file in enumerate(files):
        if mine := [one for place, one in chosen if place == i]:
            changes |= written(file, mine)
    return len(everything), changes


def tried(work: Path, changes: dict[str, dict[str, str]], options: MutantOptions) -> dict[str, str]:
    """Return the status of each mutant, of the changes by folder."""
    own = {folder: places_of(folder, options.tests) for folder in changes}
    named = [(name, own[folder]) for folder, some in changes.items() for name in some]
    # A run that is stopped early has tried a sample of each folder.
    random.Random(options.seed).shuffle(named)
    tests = sorted({place for places in own.values() for place in places})
    asked = {"mutants": dict(named), "tests": tests, "most_s": options.most_s}
    (work / "mutants.json").write_text(json.dumps(asked), encoding="utf-8")
    # The same examples each time: a draw of hypothesis must not decide about a mutant.
    env = dict(os.environ) | {"CI": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(work)}
    with (work / "trials.log").open("w", encoding="utf-8") as log:
        words = (sys.executable, "-m", "tests.laboratory.mutant_trials")
        subprocess.run(words, cwd=work, env=env, stdout=log, stderr=log, check=False)
    return json.loads((work / "statuses.json").read_text(encoding="utf-8"))


def survivors(score: Score, changes: dict[str, str]) -> str:
    """Return the change of each mutant that no test noticed, with its status."""
    left = {name: status for name, status in score.statuses.items() if status != "caught"}
    return "".join(f"{name}: {status}\n{changes[name]}\n" for name, status in left.items())


def mutants(options: Annotated[MutantOptions, tyro.conf.arg(name="")]) -> None:
    """Print the table of scores, and write the survivors to `build/mutants/`."""
    if find_spec("mutmut") is None:
        raise SystemExit("mutants: mutmut is not installed; run make .venv/dev.stamp")
    build = ROOT / "build" / "mutants"
    build.mkdir(parents=True, exist_ok=True)
    copied(build / "work")
    found = {folder: made(folder, options) for folder in options.folders}
    statuses = tried(build / "work", {name: one for name, (_, one) in found.items()}, options)
    print(HEADING)  # noqa: T201
    for folder, (count, changes) in found.items():
        score = Score(folder, count, {one: statuses[one] for one in changes if one in statuses})
        (build / f"{folder}.diff").write_text(survivors(score, changes), encoding="utf-8")
        print(score.line(), flush=True)  # noqa: T201
