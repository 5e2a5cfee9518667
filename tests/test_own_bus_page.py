"""The page of own plants behind a measurement bus: its files and its commands."""

from pathlib import Path

import pytest

from tests.pages import ROOT, blocks, commands, run_as_reader

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "own_plant_on_a_bus.md").read_text(encoding="utf-8")
ROOMS, HISTORY = blocks(PAGE, "python")


@pytest.mark.zenoh
@pytest.mark.parametrize("command", commands(PAGE))
def test_the_commands_run(command: str, tmp_path: Path):
    (tmp_path / "rooms.py").write_text(ROOMS)
    run_as_reader(command, tmp_path)


def test_the_history_prints_what_the_page_says(capsys: pytest.CaptureFixture[str]):
    exec(compile(HISTORY, "page", "exec"), {})
    cycles, trace = capsys.readouterr().out.split()
    assert f"`{cycles} {trace[:5]}...`" in PAGE
