"""docs/labelled.md: its commands run, and what it shows is there."""

from pathlib import Path

import pytest

from tests.pages import ROOT, commands, link_checkout, run_as_reader

PAGE = (ROOT / "docs" / "labelled.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return link_checkout(tmp_path_factory.mktemp("labelled"))


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.parametrize("command", commands(PAGE))
def test_a_command_of_the_page_runs(command: str, checkout: Path):
    run_as_reader(command, checkout)


def test_the_page_has_its_picture_and_its_study():
    assert len(commands(PAGE)) >= 5
    assert (ROOT / "docs" / "labelled.png").exists() and "](labelled.png)" in PAGE
    assert "concord reproduce labelled --runs 50" in PAGE
