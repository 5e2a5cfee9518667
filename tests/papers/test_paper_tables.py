"""The tables of errata in docs/papers/ are those of the code."""

import pytest

from docs.paper_tables import ERRATA, PAGES, between, errata_of, written


@pytest.mark.parametrize("paper", ERRATA)
def test_a_page_has_the_errata_of_the_code(paper: str):
    page = (PAGES / f"{paper}.md").read_text(encoding="utf-8")
    assert page == written(page, "errata", errata_of(paper)), "python -m docs.paper_tables"
    assert f"## Errata: {len(ERRATA[paper])}" in page


def test_writing_again_changes_nothing_and_keeps_what_follows():
    page = "# A page\n\nIts text.\n"
    once = written(page, "errata", "## Errata: 1")
    assert written(once, "errata", "## Errata: 1") == once
    followed = once + "\nMore.\n"
    assert written(followed, "errata", "## Errata: 2").endswith("-->\n\nMore.\n")
    assert between("errata")[0] in once
