"""Test what a newcomer reads first: README, docs/start.md, docs/index.md, and the help."""

import re

import pytest

from concord.entries import summaries
from concord.experiments.cli.help import commands_help
from tests.pages import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
FIRST_PAGES = {
    "README.md": README,
    "docs/start.md": (ROOT / "docs/start.md").read_text(encoding="utf-8"),
    "concord": commands_help(everything=False),
}
# Terms of the field and of concord, which a newcomer need not know.
TERMS = (
    "alone", "belief", "bus", "cautious", "centralised", "consensus", "covariance intersection",
    "cycle", "design", "driver", "graph", "Kalman filter", "Monte Carlo", "neighbour", "node",
    "occupancy", "overconfident", "plant", "reading", "round", "rule", "scenario", "schedule",
    "share", "step", "sweep", "topology", "verdict",
)  # fmt: skip
# Words of the verdict, which the pages explain, a placeholder, a licence and a data set.
KNOWN = {"WORKS", "CHECK", "FAILED", "COMMAND", "NAME", "MIT", "UTIAS", "MRCLAM"}


def explained() -> set[str]:
    """The words of the glossary, without marks."""
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    heads = re.findall(r"^\| (.+?) \|", text, re.MULTILINE)
    return {word.strip(" `").lower() for head in heads for word in head.split(",")}


def terms_of(page: str) -> set[str]:
    """The terms, abbreviations and rules in the sentences of a page."""
    prose = re.sub(r"^```.*?^```$", "", page, flags=re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^    .*$|\]\([^)]*\)", "", prose, flags=re.MULTILINE)
    rules = {word for word in re.findall(r"`([\w-]+)`", prose) if word in summaries("RULES")}
    prose = re.sub(r"`[^`]*`", "", prose)
    return (
        {term for term in TERMS if re.search(rf"\b{term}s?\b", prose)}
        | {
            word
            for word in re.findall(r"\b[A-Z]{3,}(?: FD)?\b(?!\.\w)", prose)
            if word not in KNOWN
        }
        | rules
    )


@pytest.mark.parametrize("name", FIRST_PAGES)
def test_the_terms_of_the_first_pages_are_in_the_glossary(name: str):
    words = explained()
    missing = [
        term
        for term in sorted(terms_of(FIRST_PAGES[name]))
        if not {term.lower(), f"{term.lower()}s"} & words
    ]
    assert not missing, f"{name}: explain {missing} in docs/glossary.md, or use other words"


def test_terms_are_found_in_sentences():
    page = "A sweep of `ci` has an ANEES.\n\n    RMSE\n\n```\nNIS `wac`\n```\n[a](GPS.md)"
    assert terms_of(page) == {"sweep", "ANEES", "ci"}


def test_the_readme_has_at_most_120_lines():
    assert len(README.splitlines()) <= 120


def test_the_first_page_of_the_site_leads_to_every_page():
    docs = ROOT / "docs"
    index = (docs / "index.md").read_text(encoding="utf-8")
    linked = {target.split("#")[0] for target in re.findall(r"\]\(([^)]+)\)", index)}
    assert {page.name for page in docs.glob("*.md")} - {"index.md"} <= linked
    assert index.index("(start.md)") == index.index("](") + 1
