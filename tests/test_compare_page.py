"""docs/which_rule_when.md: its tables name every rule and case, and its own rule runs."""

from pathlib import Path

import pytest

from concord.entries import summaries
from concord.studies.compare.suite import suite
from tests.experiments.command_support import concord
from tests.pages import ROOT, blocks, commands, run_as_reader

pytestmark = pytest.mark.slow

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
    head, _, *rows = [table for table in tables() if table[0][:2] == ["rule", "geometric"]][number]
    assert sorted(row[0] for row in rows) == sorted(summaries("RULES"))
    assert sorted(head[1:]) == sorted(case.name for case in suite())


def test_the_table_of_cases_is_that_of_the_suite():
    (cases,) = [table for table in tables() if table[0][0] == "case"]
    assert dict(row[:2] for row in cases[2:]) == {one.name: one.purpose for one in suite()}


SWEEPS = [line.strip() for line in PAGE.splitlines() if line.startswith("    concord sweep ")]


def rows_of_numbers() -> dict[tuple[str, str, str, str], int]:
    """Bytes in a step of the table of numbers, by rule, schedule, rounds and number."""
    (table,) = [table for table in tables() if table[0][0] == "rule and schedule"]
    found = {}
    for way, number, _, _, wire_bytes in table[2:]:
        rule, schedule, *rounds = way.replace("`", "").split(", ")
        key = rule, schedule, rounds[0].removesuffix(" rounds") if rounds else "3", number
        found[key] = int(wire_bytes)
    return found


@pytest.mark.study
def test_the_commands_of_the_table_of_numbers_send_its_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Bytes of rules that share beliefs are those of every step, so two short runs will do."""
    # Only here, as the other tests need no figures.
    import xarray

    monkeypatch.chdir(tmp_path)
    rows, printed = rows_of_numbers(), set()
    for count, command in enumerate(SWEEPS):
        words = command.replace("--runs 50", "--runs 2").split()[1:]
        assert concord(capsys, *words, "--steps", 24, "-o", f"{count}.nc").code == 0
        options = dict(zip(words[1::2], words[2::2], strict=True))
        with xarray.open_dataset(f"{count}.nc", engine="h5netcdf") as data:
            sent = data.bytes_per_step.mean("run")
            for row, shown in rows.items():
                asked = dict(zip(("rule", "schedule", "rounds", "number"), row, strict=True))
                flags = {"number": "record-number"} if row[0] == "labelled" else {}
                usual = {"rounds": "3", "number": "float64"}
                said = {
                    name: options.get(f"--{flags.get(name, name)}", usual.get(name, ""))
                    for name in asked
                }
                if not all(asked[name] in said[name].split(",") for name in asked):
                    continue
                place = {
                    name: int(value) if name == "rounds" else value
                    for name, value in asked.items()
                    if name in sent.dims
                }
                printed.add(row)
                if row[0] != "labelled":
                    assert float(sent.sel(place)) == shown, row
    assert printed == set(rows)


@pytest.mark.slow
def test_the_own_rule_of_the_page_runs(tmp_path: Path):
    (rule,) = blocks(PAGE, "python")
    (tmp_path / "mine.py").write_text(rule)
    for command in commands(PAGE):
        run_as_reader(command, tmp_path)
    assert "mine.py:RULE" in (tmp_path / "runs" / "try" / "table.md").read_text()
