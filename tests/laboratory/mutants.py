"""Mutation testing with mutmut on a random sample.

mutmut changes one expression of one function at a time, and runs the tests that reach the function.
A mutant that no test notices has survived. The script takes a folder of the source and its fast
tests in `tests/`, draws mutants by a seed, and prints a table of scores and each survivor.
Statements that raise errors and lines of text are left alone: their mutants change messages.
"""

import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from typing import Annotated

import tyro
from scipy.stats import binomtest

from tests.conftest import ROOT

FOLDERS = ("filters", "topology", "bus", "nodes")
# Statuses that mutmut gives to a mutant that some test noticed.
CAUGHT = ("killed", "timeout", "segfault", "suspicious")
LEFT_OUT = shutil.ignore_patterns(".venv", ".git", "build", "runs", "__pycache__", ".hypothesis")
# mutmut draws no sample, so a first call, for a mutant that does not exist, makes them all.
NO_MUTANT = "none.of.all"


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
    workers: int = 1
    """Processes that try mutants at once."""
    most_s: float = 30.0
    """A mutant meets the quickest tests that reach its function, as many as take this long."""


@dataclass(frozen=True)
class Score:
    """The drawn mutants of one folder, with their statuses."""

    folder: str
    made: int
    statuses: dict[str, str]

    @property
    def counts(self) -> Counter[str]:
        """Return the number of drawn mutants of each status of mutmut."""
        return Counter(self.statuses.values())

    @property
    def caught(self) -> int:
        """Return the number of drawn mutants that some test noticed."""
        return sum(self.counts[status] for status in CAUGHT)

    def line(self) -> str:
        """Return a row of the table, with the interval of Wilson (1927) at 95 %."""
        drawn = len(self.statuses)
        test = binomtest(self.caught, drawn)
        low, high = (100 * bound for bound in test.proportion_ci(method="wilson"))
        unreached = self.counts["no tests"]
        return (
            f"| `{self.folder}/` | {self.made} | {drawn} | {self.caught} | {unreached} | "
            f"{drawn - self.caught - unreached} | {100 * self.caught / drawn:.0f} % "
            f"({low:.0f} to {high:.0f}) |"
        )


HEADING = (
    "| folder | mutants | drawn | caught | not reached | survived | score (95 %) |\n"
    "|---|---|---|---|---|---|---|"
)


def settings(folder: str, tests: tuple[str, ...]) -> str:
    """Return mutmut's settings for one folder, in the form of `setup.cfg`."""
    chosen = [f"tests/{folder}/{name}.py" for name in tests] or [f"tests/{folder}"]
    # mutmut would write over its mutants, and make them again, if it copied the folder as well.
    package = (f"concord/{path.name}" for path in (ROOT / "concord").iterdir())
    copied = [name for name in package if name != f"concord/{folder}"]
    copied += ["docs", "examples", "benchmarks", "launch_local.py", "README.md", *FOLDERS]
    return "\n".join(
        (
            "[mutmut]",
            # The folders of `concord` are links, which mutmut does not follow further down.
            f"source_paths=concord/{folder}",
            "also_copy=" + "".join(f"\n    {name}" for name in copied),
            "pytest_add_cli_args_test_selection="
            + "\n    ".join(("", *chosen, "-m", "not (slow or zenoh or browser)")),
            # Errors, and lines that hold nothing but a piece of text.
            r"do_not_mutate_patterns=" + "\n    ".join(("", r"^\s*raise ", r'^\s*f?"[^"]*"$')),
            "",
        )
    )


def mutmut(work: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run mutmut in a folder."""
    # The same examples each time: a draw of hypothesis must not decide about a mutant.
    env = dict(os.environ) | {"CI": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        (sys.executable, "-m", "mutmut", *words),
        cwd=work,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )


def statuses(work: Path) -> dict[str, str]:
    """Return the status of each mutant by its name, as mutmut prints it."""
    printed = mutmut(work, "results", "--all", "true").stdout
    return dict(line.strip().split(": ", 1) for line in printed.splitlines() if ": " in line)


def quickest(tests: list[str], seconds: dict[str, float], most_s: float) -> list[str]:
    """Return the quickest tests that take `most_s` together, and at least one."""
    order = sorted(tests, key=lambda name: (seconds[name], name))
    ends_s = accumulate(seconds[name] for name in order)
    kept = [name for name, end_s in zip(order, ends_s, strict=True) if end_s <= most_s]
    return kept or order[:1]


def leave_slow_tests(work: Path, most_s: float) -> None:
    """Take the slowest tests of each function from mutmut's list of tests by function."""
    path = work / "mutants" / "mutmut-stats.json"
    found = json.loads(path.read_text(encoding="utf-8"))
    by_function = found["tests_by_mangled_function_name"]
    for name, tests in by_function.items():
        by_function[name] = quickest(tests, found["duration_by_test"], most_s)
    path.write_text(json.dumps(found), encoding="utf-8")


def drawn(names: list[str], options: MutantOptions) -> list[str]:
    """Return the mutants to try: the same ones for the same seed."""
    if not 0 < options.mutants < len(names):
        return names
    return sorted(random.Random(options.seed).sample(sorted(names), options.mutants))


def tried(folder: str, work: Path, options: MutantOptions) -> Score:
    """Make all mutants of a folder in a copy of the project, and try a sample of them."""
    if not work.exists():
        shutil.copytree(ROOT, work, symlinks=True, ignore=LEFT_OUT)
        (work / "setup.cfg").write_text(settings(folder, options.tests), encoding="utf-8")
    first = mutmut(work, "run", NO_MUTANT)
    names = list(statuses(work))
    if not names or "nothing matches" not in first.stderr:
        raise SystemExit(f"mutmut made no mutants of {folder}/: {first.stdout}{first.stderr}")
    leave_slow_tests(work, options.most_s)
    sample = drawn(names, options)
    second = mutmut(work, "run", "--max-children", str(options.workers), *sample)
    found = statuses(work)
    if any(found[name] == "not checked" for name in sample):
        raise SystemExit(f"mutmut did not try all mutants: {second.stdout}{second.stderr}")
    return Score(folder, len(names), {name: found[name] for name in sample})


def survivors(score: Score, work: Path) -> str:
    """Return the change of each mutant that no test noticed."""
    left = [name for name, status in score.statuses.items() if status not in CAUGHT]
    return "".join(mutmut(work, "show", name).stdout for name in left)


def mutants(options: Annotated[MutantOptions, tyro.conf.arg(name="")]) -> None:
    """Print the table of scores, and write the survivors to `build/mutants/`."""
    if find_spec("mutmut") is None:
        raise SystemExit("mutants: mutmut is not installed; run make .venv/dev.stamp")
    build = ROOT / "build" / "mutants"
    build.mkdir(parents=True, exist_ok=True)
    rows = [HEADING]
    for folder in options.folders:
        score = tried(folder, build / folder, options)
        (build / f"{folder}.diff").write_text(survivors(score, build / folder), encoding="utf-8")
        rows.append(score.line())
        print(f"{folder}: {dict(score.counts)}", flush=True)  # noqa: T201
    print("\n".join(rows))  # noqa: T201
