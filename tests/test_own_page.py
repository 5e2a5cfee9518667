"""The pages of own values: files and commands, in a folder that holds names of our folders."""

from pathlib import Path

import pytest

from tests.pages import ROOT, blocks, commands, run_as_reader

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "own_plant.md").read_text(encoding="utf-8")
NAMES = ("pendulum", "cart", "sharpest", "fading", "patient", "serial")
OWN_DATA = (ROOT / "docs" / "own_data.md").read_text(encoding="utf-8")
CHECKING = (ROOT / "docs" / "checking.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in zip(NAMES, blocks(PAGE, "python"), strict=True):
        (tmp_path / f"{name}.py").write_text(text)
    for name in ("nodes.py", "filters.py", "experiments/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("raise ImportError('of the user')\n")
    return tmp_path


@pytest.mark.zenoh
@pytest.mark.parametrize("command", [*commands(PAGE), *commands(CHECKING)])
def test_the_commands_run_beside_files_of_the_names_of_our_folders(command: str, folder: Path):
    run_as_reader(command, folder)


@pytest.mark.zenoh
def test_the_commands_of_own_data_run_one_after_the_other(tmp_path: Path):
    names = ("bicycle", "reactor", "write_log", "trolley", "session")
    for name, text in zip(names, blocks(OWN_DATA, "python"), strict=True):
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "drive").mkdir()
    (columns,) = blocks(OWN_DATA, "toml")
    (tmp_path / "drive" / "columns.toml").write_text(columns)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for command in (*commands(OWN_DATA), "python session.py"):
        run_as_reader(command, tmp_path)
    assert (tmp_path / "found.toml").is_file()
