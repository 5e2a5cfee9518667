"""`concord check` of filters: ours hold every promise, and each planted mistake is found."""

from pathlib import Path

import pytest

from concord.entries import summaries
from concord.studies.check.filter_promises import FILTER_PROMISES
from tests.experiments.test_check_rules import checked

pytestmark = pytest.mark.slow

WRONG = f"{Path(__file__).parent}/wrong_filters.py"
ABOUT_MODELS = [one.name for one in FILTER_PROMISES if one.name != "agreement"]
# Each mistake, and the promises about models that it must break.
MISTAKES = {
    "ungated": {"gate"},
    "overconfident": {"linear"},
    "mixed": {"lanes", "failed-lanes", "linear", "units"},
    "absolute": {"linear", "units"},
    "zero_for_missing": {"missing"},
    "remembering": {"memory", "linear"},
    "skewed": {"covariance"},
    "right": set(),
}


NOTES = {("mcukf", "linear"), ("imm", "linear"), ("imm", "units")}


@pytest.mark.parametrize("name", summaries("FILTERS"))
def test_our_filters_keep_each_promise(name: str, capsys: pytest.CaptureFixture[str]):
    for promise in ABOUT_MODELS:
        code, rows = checked(capsys, name, "--promise", promise, "--cases", "30")
        expected = "note" if (name, promise) in NOTES else "holds"
        assert (code, rows[promise]["status"]) == (0, expected), rows


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_is_found(mistake: str, capsys: pytest.CaptureFixture[str]):
    broken = set()
    for promise in ABOUT_MODELS:
        code, rows = checked(capsys, f"{WRONG}:{mistake}", "--promise", promise, "--cases", "20")
        assert (code == 1) == (rows[promise]["status"] == "BROKEN")
        broken |= {promise} if code else set()
    assert broken >= MISTAKES[mistake]
    assert bool(broken) == bool(MISTAKES[mistake])


@pytest.mark.zenoh
@pytest.mark.parametrize("name", [f"{WRONG}:right", "imm"])
def test_a_filter_agrees_in_every_driver(name: str, capsys: pytest.CaptureFixture[str]):
    code, rows = checked(capsys, name, "--promise", "agreement")
    assert (code, rows["agreement"]["status"]) == (0, "holds")


def test_a_filter_that_claims_nothing_about_linear_models_gets_a_note(
    capsys: pytest.CaptureFixture[str],
):
    asked = (f"{WRONG}:absolute", "--promise", "linear", "--no-linear")
    code, rows = checked(capsys, *asked)
    assert (code, rows["linear"]["status"]) == (0, "note")
