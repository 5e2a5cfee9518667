"""Fresh interpreters beside files of a user that have the names of concord's folders."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from concord.experiments import other_runs
from concord.experiments.other_runs import OtherRuns
from concord.runtime.interpreter import fresh_command, fresh_variables
from tests.experiments.support import small
from tests.processes import holds_within

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("bus", "experiments", "filters", "nodes", "runtime", "scenarios")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder in which every import of a planted file leaves a mark and fails."""
    for name in NAMES:
        text = f"open('imported', 'a').write({name!r})\nraise ImportError('of the user')\n"
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


@pytest.mark.zenoh
def test_a_run_over_processes_takes_nothing_from_the_working_folder(folder: Path):
    run = fresh_command(
        "concord.experiments", "run", "--scenario", "oscillator", "--nodes", "3", "--steps", "3",
        "--driver", "processes", "--out", "run", "--json",
    )  # fmt: skip
    done = subprocess.run(run, cwd=folder, env=fresh_variables(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    assert not (folder / "imported").exists()


def test_other_runs_take_nothing_from_the_working_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(folder)
    # At a low priority it takes long on a machine that is busy.
    monkeypatch.setattr(other_runs, "give_way", lambda *_: None)
    other = OtherRuns(small(steps=3), sparing=False)
    try:
        assert holds_within(120, lambda: not np.isnan(other(np.zeros(1)).nees_high).any())
    finally:
        other.close()
    assert not (folder / "imported").exists()


def test_concord_is_found_from_anywhere_also_where_it_is_not_installed(folder: Path):
    """-S leaves out the installed packages, and so an editable install of concord."""
    variables = {**fresh_variables(), "PYTHONDONTWRITEBYTECODE": "1"}
    code = "import concord.runtime.interpreter as one; print(one.__file__)"
    command = [sys.executable, "-P", "-S", "-c", code]
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True)
    assert Path(done.stdout.strip()) == ROOT / "concord" / "runtime" / "interpreter.py", done.stderr


def test_the_users_own_path_is_kept(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PYTHONPATH", f"/one{os.pathsep}/two")
    assert fresh_variables()["PYTHONPATH"].split(os.pathsep) == [str(ROOT), "/one", "/two"]
    # An empty entry would be the working folder.
    monkeypatch.setenv("PYTHONPATH", "")
    assert fresh_variables()["PYTHONPATH"] == str(ROOT)


def test_no_other_file_starts_an_interpreter():
    folders = (*NAMES, "benchmarks", "dashboard", "papers", "plants", "topology", "docs")
    files = [file for name in folders for file in (ROOT / name).rglob("*.py")]
    starters = [file for file in files if re.search(r"\[\s*sys\.executable", file.read_text())]
    assert starters == [ROOT / "runtime" / "interpreter.py"]
