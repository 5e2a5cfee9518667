"""Test that the targets of a page's links exist: files, pictures, other pages."""

import re
from pathlib import Path

import pytest

from tests.pages import ROOT

PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
WAYS_IN = [
    ROOT / "ARCHITECTURE.md",
    ROOT / "docs" / "decisions.md",
    *(ROOT / "docs").glob("adding_a_*.md"),
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_points_to_what_is_there(page: Path):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    here = [target for target in targets if "://" not in target]
    assert [target for target in here if not (page.parent / target).exists()] == []


def test_pages_point_to_each_other():
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert sum(len(re.findall(r"\]\([^)]+\.(?:md|png)", text)) for text in texts) > 20


@pytest.mark.parametrize("page", WAYS_IN, ids=lambda page: page.name)
def test_a_page_for_developers_names_files_that_are_there(page: Path):
    named = re.findall(
        r"`((?:[a-z_0-9]+/)+[a-z_0-9]*(?:\.\w+)?)`", page.read_text(encoding="utf-8")
    )
    assert [name for name in named if not (ROOT / name).exists()] == []
