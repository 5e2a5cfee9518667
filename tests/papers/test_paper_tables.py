"""The tables of claims and errata in docs/papers/ are those of the code."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from concord.papers import wac
from docs.paper_tables import ERRATA, PAGES, between, errata_of, written

SOURCES = Path(str(wac.__file__)).parents[1]
CELL = re.compile(r"(?<!\\)\|")


@pytest.mark.parametrize("paper", ERRATA)
def test_a_page_has_the_errata_of_the_code(paper: str):
    page = (PAGES / f"{paper}.md").read_text(encoding="utf-8")
    assert page == written(page, "errata", errata_of(paper)), "python -m docs.paper_tables"
    assert f"## Errata: {len(ERRATA[paper])}" in page


def places_of_claims(paper: str) -> Iterator[str]:
    """The first argument of each `Claim` in the code of a paper."""
    for file in (SOURCES / paper).glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "Claim":
                yield ast.literal_eval(node.args[0])


@pytest.mark.parametrize("paper", ERRATA)
def test_a_page_has_every_claim_of_the_code(paper: str):
    page = (PAGES / f"{paper}.md").read_text(encoding="utf-8")
    begin, end = between("claims")
    block = page.partition(begin)[2].partition(end)[0]
    rows = [CELL.split(line) for line in block.splitlines() if line.startswith("| ")][2:]
    assert f"`concord reproduce {paper}` measured this" in block, "make paper-tables"
    assert f"## Claims: {len(rows)}\n" in block
    assert {row[1].strip() for row in rows} == set(places_of_claims(paper)), "make paper-tables"


def test_writing_again_changes_nothing_and_keeps_what_follows():
    page = "# A page\n\nIts text.\n"
    once = written(page, "errata", "## Errata: 1")
    assert written(once, "errata", "## Errata: 1") == once
    followed = once + "\nMore.\n"
    assert written(followed, "errata", "## Errata: 2").endswith("-->\n\nMore.\n")
    assert between("errata")[0] in once
