"""A package outside the repository brings a rule, a scenario and a command by its entry points."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.features.commands import commands, page, python

PACKAGE = Path(__file__).parent / "package"
NETWORK = ("--scenario", "oscillator", "--nodes", "4", "--steps", "20", "--rule", "widest")
OWN = ("--scenario", "short-oscillator")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the package is installed from its wheel."""
    folder = tmp_path_factory.mktemp("third_party")
    shutil.copytree(PACKAGE, folder / "package")
    _pip("wheel", "--no-build-isolation", "--no-deps", "-w", str(folder), str(folder / "package"))
    (wheel,) = folder.glob("*.whl")
    _pip("install", "--no-index", "--no-deps", "--target", str(folder / "site"), str(wheel))
    return folder / "site"


def _pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_its_names_are_listed_with_their_summaries(site: Path, tmp_path: Path):
    printed = python(site, tmp_path, commands(["list", "--json"], ["help", "--all"]))
    for words in ("Mean of the means, with the widest", "short-oscillator", "Greet a user by name"):
        assert words in printed


def test_its_command_runs(site: Path, tmp_path: Path):
    assert "good day, Ada" in python(site, tmp_path, commands(["greet", "Ada"]))


@pytest.mark.zenoh
def test_its_rule_runs_in_every_driver(site: Path, tmp_path: Path):
    python(site, tmp_path, commands(["agree", *NETWORK]))


def test_its_rule_takes_part_in_a_sweep(site: Path, tmp_path: Path):
    rules = (*NETWORK[:-1], "ci,widest", "--runs", "2", "--workers", "1", "--out", "sweep.nc")
    assert "widest" in python(site, tmp_path, commands(["sweep", *rules]))


def test_its_scenario_runs_and_the_page_opens(site: Path, tmp_path: Path):
    run = commands(["run", *OWN, "--rule", "widest", "--out", "run"])
    python(site, tmp_path, run + page("run"))


@pytest.mark.zenoh
def test_its_scenario_runs_as_processes(site: Path, tmp_path: Path):
    python(site, tmp_path, commands(["run", *OWN, "--driver", "processes", "--out", "run"]))
