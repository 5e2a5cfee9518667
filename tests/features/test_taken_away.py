"""Each feature can be taken away, and the papers: a concord without it does all that is general."""

import ast
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.features.commands import commands, page, python

PAPERS = "papers"
FEATURES = sorted(file.parent.name for file in ROOT.glob("features/*/entries.py"))
SMALL = ("--scenario", "target-tracking", "--nodes", "4", "--steps", "3")
GONE = "from importlib.util import find_spec; assert find_spec('concord.{}') is None\n"


def needs(feature: str) -> set[str]:
    """Return the features that one names in its NEEDS."""
    for node in ast.parse((ROOT / "features" / feature / "entries.py").read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "NEEDS":
            return set(ast.literal_eval(node.value))
    return set()


def without(feature: str) -> set[str]:
    """Return a feature and all that need it, also by way of others."""
    gone = {feature}
    while more := {one for one in FEATURES if needs(one) & gone} - gone:
        gone |= more
    return gone


def tree_without(gone: set[str], folder: Path) -> Path:
    """Make a package `concord` of links to this one, but for some features; return its folder."""
    package = folder / "tree" / "concord"
    (package / "features").mkdir(parents=True)
    for entry in (ROOT / "concord").iterdir():
        if entry.name not in {"features", "__pycache__", *gone}:
            (package / entry.name).symlink_to(entry.resolve())
    for entry in (ROOT / "features").iterdir():
        if entry.name not in gone:
            (package / "features" / entry.name).symlink_to(entry)
    return package.parent


@pytest.mark.parametrize("feature", [*FEATURES, PAPERS])
def test_all_that_is_general_works_without_it(feature: str, tmp_path: Path):
    program = commands(["list"], ["run", *SMALL, "--out", "run"])
    gone = GONE.format(PAPERS if feature == PAPERS else f"features.{feature}")
    tree = tree_without(without(feature), tmp_path)
    printed = python(tree, tmp_path, gone + program + page("run"))
    assert "target-tracking" in printed and "sharp-ci" in printed


@pytest.mark.zenoh
def test_commands_and_processes_run_without_all_of_them(tmp_path: Path):
    program = commands(
        ["--help"],
        ["run", *SMALL, "--driver", "processes", "--out", "run"],
        ["sweep", *SMALL, "--rule", "ci,wac", "--runs", "2", "--workers", "1", "--out", "s.nc"],
    )
    python(tree_without({*FEATURES, PAPERS}, tmp_path), tmp_path, program)


def test_a_name_of_a_feature_goes_with_it(tmp_path: Path):
    printed = python(tree_without({"other_buses"}, tmp_path), tmp_path, commands(["list"]))
    assert "flexray" in printed and "can-fd" not in printed


def test_a_feature_takes_those_that_need_it_away():
    assert "sets" in without("measurement_bus")
