"""Every example and every notebook runs as a reader would run it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import matplotlib.pyplot
import pytest

from tests.pages import ROOT, commands

pytestmark = pytest.mark.slow

matplotlib.use("Agg")
SCRIPTS = sorted(file.name for file in (ROOT / "examples").glob("*.py"))
RUN_BY_PAGES = {
    name
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"))
    for command in commands(page.read_text(encoding="utf-8"))
    for name in SCRIPTS
    if f"python examples/{name}" in command
}
"""The tests of the pages run these."""
NOTEBOOKS = sorted(file.name for file in (ROOT / "examples").glob("*.ipynb"))
DATA = ROOT.parent / "shared" / "data" / "mrclam6"


def test_there_are_examples():
    assert len(SCRIPTS) >= 9 and len(NOTEBOOKS) >= 4


@pytest.mark.zenoh
@pytest.mark.parametrize("name", sorted({*SCRIPTS} - RUN_BY_PAGES))
def test_a_script_runs(name: str, tmp_path: Path):
    arguments = [str(DATA)] if name == "recorded_data.py" else []
    if arguments and not DATA.is_dir():
        pytest.skip("needs the MRCLAM data in ../shared/data, which are no part of the checkout")
    command = [sys.executable, str(ROOT / "examples" / name), *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.zenoh
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_cells_of_a_notebook_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    book = json.loads((ROOT / "examples" / name).read_text(encoding="utf-8"))
    code = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    assert len(code) >= 2 and not any(cell.get("outputs") for cell in book["cells"])
    namespace: dict = {"__name__": "notebook"}
    for cell in code:
        exec(cell, namespace)
    matplotlib.pyplot.close("all")


def test_the_own_values_of_the_examples_run_by_their_names(tmp_path: Path):
    own = [f"{ROOT}/examples/{name}" for name in ("own_plant.py:PENDULUM", "own_rule.py:cautious")]
    command = [sys.executable, "-m", "concord.experiments", "run", "--scenario", own[0]]
    command += ["--rule", own[1], "--steps", "30", "--out", str(tmp_path / "run"), "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["steps"] == 30


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from tests.pages import blocks

    monkeypatch.chdir(tmp_path)
    (code,) = blocks((ROOT / "README.md").read_text(encoding="utf-8"), "python")
    exec(code, {"__name__": "readme"})
    assert (tmp_path / "pareto.png").is_file()


def test_the_lines_that_the_readme_shows_are_those_of_the_demo(tmp_path: Path):
    command = [sys.executable, "-m", "concord.experiments", "run", "--out", "run"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    for page in ("README.md", "docs/start.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        (shown,) = re.findall(r"^  error .*?\n(?=Files|```)", text, re.MULTILINE | re.DOTALL)
        assert shown in done.stdout, page
