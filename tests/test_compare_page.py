"""docs/which_rule_when.md: its tables name every rule and case, and its own rule runs."""

from pathlib import Path

import pytest

from concord.experiments.compare.suite import SUITE
from concord.scenarios.types.rules import RULE_SUMMARIES
from tests.pages import ROOT, blocks, commands, run_as_reader

PAGE = (ROOT / "docs" / "which_rule_when.md").read_text(encoding="utf-8")


def tables() -> list[list[list[str]]]:
    """Return the tables of the page as rows of cells."""
    found: list[list[list[str]]] = [[]]
    for line in PAGE.splitlines():
        if line.startswith("|"):
            found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
        elif found[-1]:
            found.append([])
    return [table for table in found if table]


@pytest.mark.parametrize("number", range(5))
def test_each_table_of_figures_has_every_built_in_rule_and_every_case(number: int):
    head, _, *rows = [table for table in tables() if table[0][0] == "rule"][number]
    assert sorted(row[0] for row in rows) == sorted(RULE_SUMMARIES)
    assert head[1:] == [case.name for case in SUITE]


def test_the_table_of_cases_is_that_of_the_suite():
    (cases,) = [table for table in tables() if table[0][0] == "case"]
    assert [row[:2] for row in cases[2:]] == [[case.name, case.purpose] for case in SUITE]


@pytest.mark.slow
def test_the_own_rule_of_the_page_runs(tmp_path: Path):
    (rule,) = blocks(PAGE, "python")
    (tmp_path / "mine.py").write_text(rule)
    for command in commands(PAGE):
        run_as_reader(command, tmp_path)
    assert "mine.py:RULE" in (tmp_path / "runs" / "try" / "table.md").read_text()
