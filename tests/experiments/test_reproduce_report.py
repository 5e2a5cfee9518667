"""`concord reproduce`: the report of any paper, its exit codes, and what an interruption leaves."""

import json
from pathlib import Path

import pytest

from experiments.__main__ import main
from experiments.reproduce_command import REPRODUCTIONS, carry_out
from experiments.reproduce_report import (
    Check,
    Claim,
    Reproduction,
    Section,
    above,
    at_most,
    below,
    markdown_table,
    near,
    refused,
    report_of,
    to_markdown,
)


def section(place: int, *checks: Check) -> Section:
    return Section(place, f"part {place}", "a | b", list(checks))


def test_the_report_counts_what_fails():
    good, bad = near("fine", 1.0, 1.0, 0.1), near("gone", 2.0, 1.0, 0.1)
    assert report_of("p", 1, [section(0, good)], complete=True).ok
    assert not report_of("p", 1, [section(0, good)], complete=False).ok
    report = report_of("p", 7, [section(1, bad), section(0, good)], complete=True)
    assert not report.ok
    assert [part.place for part in report.sections] == [0, 1]
    text = to_markdown(report, "Title")
    assert "1 of 2 checks hold" in text
    assert "- gone" in text
    assert "Seed 7; concord" in text


def test_each_section_is_told_when_it_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    told = []

    def sections(_folder: Path):
        for place in (1, 0):
            yield section(place)
            told.append(capsys.readouterr().err)

    carry_out("p", Reproduction("Title", 1, sections), tmp_path)
    assert told == ["done: part 1\n", "done: part 0\n"]


NAN = float("nan")


def test_checks_hold_up_to_their_bounds():
    assert near("x", 1.5, 1.0, 0.5).ok
    assert not near("x", 1.51, 1.0, 0.5).ok
    assert at_most("x", 1.0, 1.0).ok
    assert not at_most("x", 1.0 + 1e-15, 1.0).ok
    assert not above("x", 1.0, 1.0).ok
    assert not below("x", 1.0, 1.0).ok
    assert above("x", 1.1, 1.0).ok
    assert below("x", 0.9, 1.0).ok


def test_nan_passes_no_check():
    checks = (
        near("x", NAN, 1.0, 1e9),
        at_most("x", NAN, 1),
        above("x", NAN, 1),
        below("x", NAN, 1),
    )
    assert not any(check.ok for check in checks)


def test_a_refusal_needs_its_reason():
    assert refused("x", lambda: float("word"), "could not convert").ok
    assert not refused("x", lambda: float("word"), "too large").ok
    assert refused("x", lambda: float("1"), "could not convert").measured == "accepted"


def test_a_table_survives_bars_in_its_cells():
    claim = Claim("(1)", "|z| < 1", "wrong", "|z| = 4.77\nindeed", 8)
    report = report_of("p", 1, [Section(0, "claims", claims=[claim])], complete=True)
    (row,) = [line for line in to_markdown(report, "T").splitlines() if "4.77" in line]
    assert row.replace("\\|", "").count("|") == 5
    assert "(erratum 8)" in row


def pretend(monkeypatch: pytest.MonkeyPatch, sections) -> None:
    made = Reproduction("Pretended", 3, sections)
    monkeypatch.setitem(REPRODUCTIONS, "wac", lambda runs: made)


def run(*arguments: str) -> int:
    try:
        main(["reproduce", *arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_failed_check_is_exit_code_1(monkeypatch, tmp_path: Path, capsys):
    pretend(monkeypatch, lambda folder: iter([section(0, near("gone", 2.0, 1.0, 0.1))]))
    assert run("wac", "--out", str(tmp_path / "a"), "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["complete"], told["seed"]) == (False, True, 3)
    assert told["sections"][0]["checks"][0]["measured"] == 2.0
    pretend(monkeypatch, lambda folder: iter([section(0, near("fine", 1.0, 1.0, 0.1))]))
    assert run("wac", "--out", str(tmp_path / "b")) == 0
    assert "1 of 1 checks hold" in capsys.readouterr().out


def test_what_is_shown_stands_on_the_terminal_with_its_tables(monkeypatch, tmp_path: Path, capsys):
    table = markdown_table(["filter", "RMSE"], [["CKF", "0.1 ± 0.02"]])
    parts = [Section(1, "Hidden", "nothing"), Section(0, "Shown", f"Text.\n\n{table}", shown=True)]
    pretend(monkeypatch, lambda folder: iter(parts))
    assert run("wac", "--out", str(tmp_path / "a")) == 0
    said = capsys.readouterr().out
    assert "Hidden" not in said
    assert "|" not in said  # a table, not its Markdown
    rows = [line.split() for line in said.splitlines() if line.strip()]
    for row in (["Shown"], ["Text."], ["filter", "RMSE"], ["CKF", "0.1", "±", "0.02"]):
        assert row in rows
    pretend(monkeypatch, lambda folder: iter(parts))
    assert run("wac", "--out", str(tmp_path / "b"), "--json") == 0
    assert json.loads(capsys.readouterr().out)["sections"][0]["shown"] is True


def test_an_interrupted_reproduction_leaves_what_is_done(monkeypatch, tmp_path: Path):
    def sections(folder: Path):
        yield section(0, near("fine", 1.0, 1.0, 0.1))
        raise KeyboardInterrupt

    pretend(monkeypatch, sections)
    assert run("wac", "--out", str(tmp_path / "a")) == 130
    text = (tmp_path / "a" / "report.md").read_text(encoding="utf-8")
    assert "Not complete" in text
    assert "## part 0" in text


@pytest.mark.parametrize(
    ("paper", "out", "says"),
    [("wac", "there", "the folder exists"), ("wak", "new", "did you mean 'wac'")],
)
def test_a_mistake_is_exit_code_2(tmp_path: Path, capsys, paper: str, out: str, says: str):
    (tmp_path / "there").mkdir()
    assert run(paper, "--out", str(tmp_path / out)) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
