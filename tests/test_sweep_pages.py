"""docs/sweeps.md and docs/python_api.md: their commands and their code run as printed."""

from pathlib import Path

import pytest

from concord.results.figures.figure_table import FIGURES
from tests.pages import ROOT, blocks, commands, link_checkout, run_as_reader

pytestmark = pytest.mark.slow

SWEEPS = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")
PYTHON = (ROOT / "docs" / "python_api.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_commands_run_one_after_the_other(tmp_path: Path):
    checkout = link_checkout(tmp_path)
    for command in commands(SWEEPS):
        run_as_reader(command, checkout)
    for made in ("sweep.nc", "sweep.html", "design.json", "sweep-plots/pareto.svg"):
        assert (checkout / made).stat().st_size > 1000, made


def test_the_page_names_every_variable():
    pages = {True: SWEEPS, False: (ROOT / "docs" / "results.md").read_text(encoding="utf-8")}
    missing = [name for name, one in FIGURES.items() if f"`{name}`" not in pages[one.is_swept]]
    assert not missing, f"add {missing} to the tables of docs/sweeps.md or results.md"


def test_the_python_code_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.chdir(tmp_path)
    namespace: dict = {}
    for block in blocks(PYTHON, "python"):
        exec(block, namespace)
    assert (tmp_path / "pareto.svg").stat().st_size > 1000
    assert "ring" in capsys.readouterr().out
