"""`concord check` of rules: correct rules hold every promise, and each planted mistake is found."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from concord.entries import chosen, entries
from concord.experiments.cli.command_line import main
from concord.scenarios.rule_table.rule import Rule
from concord.studies.check.rule_promises import RULE_PROMISES
from tests.pages import ROOT, blocks

pytestmark = pytest.mark.slow

WRONG = f"{Path(__file__).parent}/wrong_rules.py"
NAMES = [promise.name for promise in RULE_PROMISES]
ABOUT_BELIEFS = NAMES[: NAMES.index("loss")]
# Each mistake, and every promise about beliefs that it breaks.
MISTAKES = {
    "order_dependence": {"order"},
    "mixed_lanes": {"lanes"},
    "double_counting": {"equal", "consistent"},
    "nan_leak": {"unheard"},
    "overconfidence": {"equal", "consistent"},
    "wrong_shape": {*ABOUT_BELIEFS},
    "without_lanes": {*ABOUT_BELIEFS},
}


def checked(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any]]:
    """Exit code and rows by promise of `concord check --json`."""
    with pytest.raises(SystemExit) as ended:
        main(["check", *arguments, "--json", "--workers", "1"])
    rows = json.loads(capsys.readouterr().out)["promises"]
    return int(ended.value.code or 0), {row["promise"]: row for row in rows}


@pytest.fixture(scope="module")
def sharpest(tmp_path_factory: pytest.TempPathFactory) -> str:
    page = (ROOT / "docs" / "own_plant.md").read_text(encoding="utf-8")
    file = tmp_path_factory.mktemp("rule") / "sharpest.py"
    (code,) = (block for block in blocks(page, "python") if "def sharpest" in block)
    file.write_text(code)
    return f"{file}:sharpest"


@pytest.mark.zenoh
@pytest.mark.parametrize("promise", NAMES)
@pytest.mark.parametrize("rule", ["sharpest", "ci", "trimmed-ci"])
def test_a_correct_rule_keeps_each_promise(
    rule: str, promise: str, sharpest: str, capsys: pytest.CaptureFixture[str]
):
    name = sharpest if rule == "sharpest" else rule
    cases = "3" if promise == "networks" else "30"
    code, rows = checked(capsys, name, "--promise", promise, "--cases", cases)
    assert (code, rows[promise]["status"]) == (0, "holds"), rows[promise]["seen"]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_is_found(mistake: str, capsys: pytest.CaptureFixture[str]):
    broken = set()
    for promise in ABOUT_BELIEFS:
        code, rows = checked(capsys, f"{WRONG}:{mistake}", "--promise", promise, "--cases", "20")
        row = rows[promise]
        if row["status"] == "BROKEN":
            broken.add(promise)
            again = shlex.split(row["again"])[2:]
            assert (code, checked(capsys, *again)[1][promise]["seen"]) == (1, row["seen"])
    assert broken - {"units"} == MISTAKES[mistake] - {"units"}


def test_the_case_of_a_finding_is_small(capsys: pytest.CaptureFixture[str]):
    _, rows = checked(capsys, f"{WRONG}:order_dependence", "--promise", "order", "--cases", "20")
    assert "neighbours 2, states 1" in rows["order"]["seen"]
    _, rows = checked(capsys, f"{WRONG}:double_counting", "--promise", "equal", "--cases", "20")
    assert rows["equal"]["values"]["cov"] and len(rows["equal"]["values"]["weights"]) == 2


def test_a_rule_that_claims_no_consistency_breaks_no_promise(capsys: pytest.CaptureFixture[str]):
    asked = (f"{WRONG}:overconfidence", "--promise", "consistent", "--cases", "5")
    code, rows = checked(capsys, *asked, "--no-consistent")
    assert (code, rows["consistent"]["status"]) == (0, "note")


def test_a_network_that_fails_is_repeated_by_its_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    _, rows = checked(capsys, f"{WRONG}:wrong_shape", "--promise", "networks", "--cases", "1")
    assert rows["networks"]["status"] == "BROKEN" and "2 nodes, 1 steps" in rows["networks"]["seen"]
    again = shlex.split(rows["networks"]["again"])
    assert again[:2] == ["concord", "run"]
    with pytest.raises(SystemExit) as ended:
        main([*again[1:], "--out", str(tmp_path / "run"), "--json"])
    assert ended.value.code == 2
    assert capsys.readouterr().err.strip().partition(": ")[2] in rows["networks"]["seen"]


def test_information_that_counts_twice_shows_in_a_network_too(capsys: pytest.CaptureFixture[str]):
    asked = (f"{WRONG}:double_counting", "--promise", "networks", "--case", "5")
    code, rows = checked(capsys, *asked)
    assert (code, rows["networks"]["status"]) == (1, "BROKEN")
    seen = rows["networks"]["seen"]
    assert "errs by" in seen or "of the least variance" in seen
    code, rows = checked(capsys, *asked, "--no-consistent")
    assert (code, rows["networks"]["status"]) == (0, "holds")


def test_a_rule_of_the_table_says_itself_whether_it_is_consistent():
    """A new rule claims consistency unless its entry says otherwise."""
    found = {name: chosen("RULES", name) for name, one in entries("RULES").items() if one.target}
    rules = {name: value for name, value in found.items() if isinstance(value, Rule)}
    wrong = {name for name, rule in rules.items() if not rule.consistent}
    assert wrong == {"trimmed-ci", "icf", "diffusion", "kcf"}
    assert Rule._field_defaults["consistent"]


def test_a_rule_of_other_shares_skips_promises_about_beliefs(capsys: pytest.CaptureFixture[str]):
    code, rows = checked(capsys, "hcmci", "--promise", "order")
    assert (code, rows["order"]["status"]) == (0, "skipped")
    _, rows = checked(capsys, "centralised", "--promise", "loss")
    assert "--loss 0.3" in rows["loss"]["seen"]


def test_the_table_has_a_line_for_each_promise(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["check", f"{WRONG}:double_counting", "--promise", "equal", "--cases", "3"])
    assert ended.value.code == 1
    line, smallest, repeat, summary = capsys.readouterr().out.splitlines()
    assert line.startswith("BROKEN  equal") and "2 equal beliefs give" in line
    assert smallest.strip().startswith("smallest: mean [[") and "weights [" in smallest
    assert repeat.strip().startswith("repeat: concord check")
    assert summary.endswith("1 of 1 promises broken")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none-such"], "none-such"),
        ([f"{WRONG}:none"], "unknown name"),
        ([f"{WRONG}:NOT_A_RULE"], "it must be a function"),
        (["ci", "--promise", "none"], "unknown promise 'none'"),
        (["ci", "--cases", "0"], "--cases 0: must be at least 1"),
        (["ci", "--case", "0"], "--case 0: must be at least 1"),
        (["ci", "--workers", "0"], "--workers 0"),
    ],
)
def test_bad_input_is_refused(arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["check", *arguments])
    assert ended.value.code == 2 and says in capsys.readouterr().err
