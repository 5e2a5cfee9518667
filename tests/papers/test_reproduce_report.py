"""`concord reproduce`: the report of any paper, its exit codes, and what an interruption leaves."""

import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.papers import reproduce
from concord.papers.kit.judging import (
    Check,
    Claim,
    ClaimFinding,
    Erratum,
    Test,
    above,
    agrees,
    at_most,
    below,
    near,
    needs,
    refused,
    verdict_of,
)
from concord.papers.kit.report import Paper, Section, markdown_table, report_of, to_markdown
from concord.papers.reproduce import carry_out
from concord.results.figures.intervals import Interval, mean_t

pytestmark = pytest.mark.slow


def section(place: int, *checks: Check) -> Section:
    return Section(place, f"part {place}", "a | b", list(checks))


def paper(sections) -> Paper:
    return Paper("Pretended", 3, 5, 2, "so that runs can be compared", sections)


def test_the_report_counts_what_fails():
    good, bad = near("fine", 1.0, 1.0, 0.1), near("gone", 2.0, 1.0, 0.1)
    assert report_of("p", 1, 2, [section(0, good)], complete=True).ok
    assert not report_of("p", 1, 2, [section(0, good)], complete=False).ok
    report = report_of("p", 7, 2, [section(1, bad), section(0, good)], complete=True)
    assert not report.ok
    assert [part.place for part in report.sections] == [0, 1]
    text = to_markdown(report, "Title")
    assert "1 of 2 checks hold" in text
    assert "- gone" in text
    assert "Seed 7, 2 runs; concord" in text


def test_each_section_is_told_when_it_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    told = []

    def sections(_folder: Path, _seed: int, _runs: int):
        for place in (1, 0):
            yield section(place)
            told.append(capsys.readouterr().err)

    carry_out("p", paper(sections), tmp_path, 1, 2)
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
    intervals = [Interval(1.0, 0.8, high) for high in (1.2, 0.9)]
    assert [below("x", one, 1.0).outcome for one in intervals] == ["undecided", "holds"]
    assert below("x", Interval(1.3, 1.1, 1.5), 1.0).outcome == "fails"


@pytest.mark.parametrize(
    ("low", "high", "outcomes"),
    [
        (1.1, 1.2, ("holds", "holds", "fails")),
        (0.9, 1.2, ("holds", "undecided", "undecided")),
        (0.7, 0.9, ("undecided", "fails", "holds")),
        (0.4, 0.7, ("fails", "fails", "holds")),
        # One run has no interval.
        (NAN, NAN, ("undecided", "undecided", "undecided")),
    ],
)
def test_a_band_is_judged_by_the_interval_of_the_runs(low: float, high: float, outcomes: tuple):
    measured = Interval(1.0, low, high)
    checks = near("x", measured, 1.0, 0.2), above("x", measured, 1.0), at_most("x", measured, 1.0)
    assert tuple(check.outcome for check in checks) == outcomes


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
    claim = Claim("(1)", "|z| < 1", [needs(4.77, at_most=1.0)], "|z| = 4.77\nindeed", 8)
    made = Section(0, "claims", claims=[claim], errata=[Erratum(8, "(1)", "|z|", "1")])
    report = report_of("p", 1, 2, [made], complete=True)
    (row,) = [line for line in to_markdown(report, "T").splitlines() if "4.77" in line]
    assert row.replace("\\|", "").count("|") == 5
    assert "**does not hold** (erratum 8)" in row
    assert "Errata: 1." in to_markdown(report, "T")


# --- verdicts ------------------------------------------------------------------------------------

HOLDS, FAILS = needs(0.5, at_most=1.0), needs(Interval(1.2, 1.1, 1.3), at_most=1.0)
OPEN = needs(Interval(1.0, 0.8, 1.2), at_most=1.0)
UNKNOWN = needs(NAN, at_most=1.0)


@pytest.mark.parametrize(
    ("findings", "test", "verdict"),
    [
        ([HOLDS, HOLDS], "every finding", "holds"),
        ([HOLDS, FAILS], "every finding", "does not hold"),
        ([OPEN, FAILS], "every finding", "does not hold"),
        ([HOLDS, OPEN], "every finding", "not comparable"),
        ([UNKNOWN], "every finding", "not comparable"),
        ([HOLDS, FAILS], "any open choice", "not comparable"),
        ([FAILS, FAILS], "any open choice", "does not hold"),
        ([HOLDS, HOLDS], "any open choice", "holds"),
        ([HOLDS, FAILS], "print against print", "contradicts itself"),
        ([HOLDS], "print against print", "holds"),
    ],
)
def test_a_verdict_follows_from_the_findings(
    findings: list[ClaimFinding], test: Test, verdict: str
):
    assert verdict_of(findings, test) == verdict
    assert Claim("1", "so", findings, "", test=test).verdict == verdict


def test_a_claim_without_a_finding_and_a_typed_verdict_are_refused():
    with pytest.raises(ValueError, match="cannot fail"):
        Claim("1", "so", [], "")
    with pytest.raises(TypeError, match="verdict"):
        Claim("1", "so", [HOLDS], "", verdict="holds")  # pyright: ignore[reportCallIssue]


def test_a_band_is_as_wide_as_the_runs_say():
    known = Interval(1.0, 0.9, 1.1)
    assert agrees("x", known, 30, 1.1).ok
    assert not agrees("x", known, 30, 1.3).ok
    assert agrees("x", known, 30, 1.25, of_runs=30).ok
    assert agrees("x", known, 30, 1.1).outcome == "holds"
    assert agrees("x", known, 2, 1.1).outcome == "undecided"
    assert agrees("x", Interval(1.0, 0.99, 1.01), 2, 9.0).outcome == "fails"
    # Of a positive figure the interval reaches further up than down.
    heavy = Interval(1.0, 0.9, 1.4)
    assert agrees("x", heavy, 30, 1.5).ok and not agrees("x", heavy, 30, 0.7).ok
    assert not agrees("x", Interval(1.0, 0.99, 1.01), 30, 1.1).ok
    assert not agrees("x", Interval(1.0, NAN, NAN), 1, 1.0).ok


def test_bands_hold_another_study_as_often_as_they_say():
    generator = np.random.default_rng(3)
    misses = 0
    for _ in range(1500):
        ours, theirs = generator.normal(2.0, 0.3, 25), generator.normal(2.0, 0.3, 40)
        found = agrees("x", mean_t(ours), 25, float(theirs.mean()), of_runs=40)
        misses += not found.ok
    # One in a thousand: 1.5 expected.
    assert misses <= 7


def test_the_report_is_json_too(tmp_path: Path):
    claim = Claim("(1)", "so", [FAILS], "1.2")
    made = Section(0, "claims", claims=[claim])
    carry_out("p", paper(lambda *_: iter([made])), tmp_path, 1, 2)
    written = json.loads((tmp_path / "report.json").read_bytes())
    (told,) = written["sections"][0]["claims"]
    assert (told["verdict"], told["findings"][0]["value"]) == ("does not hold", 1.2)
    assert (written["complete"], written["runs"]) == (True, 2)


def test_too_few_runs_are_exit_code_2(monkeypatch, tmp_path: Path, capsys):
    pretend(monkeypatch, lambda folder, seed, runs: iter([]))
    assert run("wac", "--runs", "1", "--out", str(tmp_path / "a")) == 2
    assert "--runs 1: must be at least 2, so that runs can be compared" in capsys.readouterr().err


def pretend(monkeypatch: pytest.MonkeyPatch, sections) -> None:
    monkeypatch.setattr(reproduce, "paper_of", lambda name: paper(sections))


def run(*arguments: str) -> int:
    try:
        main(["reproduce", *arguments])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_a_failed_check_is_exit_code_1(monkeypatch, tmp_path: Path, capsys):
    pretend(monkeypatch, lambda folder, seed, runs: iter([section(0, near("gone", 2.0, 1.0, 0.1))]))
    assert run("wac", "--out", str(tmp_path / "a"), "--json") == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["complete"], told["seed"]) == (False, True, 3)
    assert told["sections"][0]["checks"][0]["measured"] == 2.0
    pretend(monkeypatch, lambda folder, seed, runs: iter([section(0, near("fine", 1.0, 1.0, 0.1))]))
    assert run("wac", "--out", str(tmp_path / "b")) == 0
    assert "1 of 1 checks hold" in capsys.readouterr().out


def test_what_is_shown_stands_on_the_terminal_with_its_tables(monkeypatch, tmp_path: Path, capsys):
    table = markdown_table(["filter", "RMSE"], [["CKF", "0.1 ± 0.02"]])
    parts = [Section(1, "Hidden", "nothing"), Section(0, "Shown", f"Text.\n\n{table}", shown=True)]
    pretend(monkeypatch, lambda folder, seed, runs: iter(parts))
    assert run("wac", "--out", str(tmp_path / "a")) == 0
    said = capsys.readouterr().out
    assert "Hidden" not in said
    assert "|" not in said  # a table, not its Markdown
    rows = [line.split() for line in said.splitlines() if line.strip()]
    for row in (["Shown"], ["Text."], ["filter", "RMSE"], ["CKF", "0.1", "±", "0.02"]):
        assert row in rows
    pretend(monkeypatch, lambda folder, seed, runs: iter(parts))
    assert run("wac", "--out", str(tmp_path / "b"), "--json") == 0
    assert json.loads(capsys.readouterr().out)["sections"][0]["shown"] is True


def test_an_interrupted_reproduction_leaves_what_is_done(monkeypatch, tmp_path: Path):
    def sections(folder: Path, seed: int, runs: int):
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
