"""docs/exact.md: its commands and its code run as printed."""

from pathlib import Path

import pytest

from tests.pages import ROOT, blocks, commands, link_checkout, run_as_reader

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "exact.md").read_text(encoding="utf-8")


def test_the_commands_run(tmp_path: Path):
    checkout = link_checkout(tmp_path)
    for command in commands(PAGE):
        run_as_reader(command, checkout)
    for made in ("exact.nc", "exact.json", "exact-compare/report.html"):
        assert (checkout / made).stat().st_size > 1000, made


def test_the_python_code_runs(capsys: pytest.CaptureFixture[str]):
    for block in blocks(PAGE, "python"):
        exec(block, {})
    assert "Steady(" in capsys.readouterr().out
