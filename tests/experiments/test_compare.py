"""`concord compare`: the suite, paired figures of all rules and own ones, reasons, resumption."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

import concord as cc
from concord.entries import summaries
from concord.filters.fusion.averaging import covariance_intersection
from concord.filters.gaussian import Gaussian
from concord.scenarios.catalogue import definition_named
from concord.studies.compare import entries as entries_module
from concord.studies.compare.entries import asked_cases, entries_of
from concord.studies.compare.results import comparison_figures
from concord.studies.compare.run import KEPT, compute_missing, kept_before
from concord.studies.compare.suite import suite
from concord.studies.compare.tables import latex
from concord.studies.sweep.workers import in_this_process
from tests.experiments.command_support import concord
from tests.processes import CONCORD, family, interrupted

pytestmark = pytest.mark.slow

CASE = "blind"
MEASURED = {"node_us"}


def lost(beliefs, weights):
    """Return beliefs that are not numbers, for lanes as only the batched driver has them."""
    value = np.nan if weights.ndim == 3 else 1.0
    return Gaussian(beliefs.mean[..., 0, :] * value, beliefs.cov[..., 0, :, :])


def broken(beliefs, weights):
    """Fail in the first fusion."""
    raise ZeroDivisionError("no neighbour")


def intersected(beliefs, weights):
    """Do what rule ci does."""
    return covariance_intersection(beliefs, weights)


@pytest.fixture(scope="module", autouse=True)
def short_cases():
    """Give every case few steps."""
    short = [case._replace(options={**case.options, "steps": "40"}) for case in suite()]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(entries_module, "suite", lambda: tuple(short))
        yield


@pytest.fixture(scope="module")
def result():
    return cc.compare(rules=[intersected, broken, lost], cases=[CASE], runs=3)


def test_every_case_prepares_with_the_rules_for_any_network():
    entries = entries_of(suite(), {}, None)
    assert len(entries) == len(suite()) * len(summaries("RULES"))
    for entry in entries:
        wired = definition_named(entry.case.options["scenario"]).wirings
        if entry.case.recorded:
            assert "--data" in entry.reason
        elif wired:
            assert (not entry.reason) is (entry.rule in wired), entry
        elif entry.rule in ("ci", "wac", "hcmci", "labelled", "local"):
            assert not entry.reason, entry
    ran = {entry.rule for entry in entries if not entry.reason}
    assert set(summaries("RULES")) - ran == {"reception"}


def test_names_of_cases_are_unique_and_fit_a_column():
    names = [case.name for case in suite()]
    assert len(set(names)) == len(names) and max(map(len, names)) <= 12


def test_every_built_in_rule_has_figures_or_a_reason(result):
    assert set(summaries("RULES")) < set(result["rule"].to_numpy().tolist())
    found = {one.rule: one for one in comparison_figures(result).cases[0].rules}
    for rule in summaries("RULES"):
        has = np.isfinite(found[rule].to_centralised.value) and found[rule].node_ratio >= 1
        assert has != bool(found[rule].reason), found[rule]
    assert "hear all" in found["centralised"].reason
    assert "meng2025" in found["reception"].reason


def test_an_own_rule_that_is_a_built_in_one_has_its_figures(result):
    own, usual = (result.sel(case=CASE, rule=rule) for rule in ("intersected", "ci"))
    for name in set(result.data_vars) - MEASURED - {"reason"}:
        np.testing.assert_allclose(own[name], usual[name], rtol=1e-9, err_msg=str(name))


def test_an_own_rule_that_fails_is_shown_with_its_reason(result):
    failed = result.sel(case=CASE, rule="broken")
    assert "in broken: ZeroDivisionError: no neighbour" in str(failed["reason"].item())
    assert np.isnan(failed["rmse"]).all()


def test_noise_is_fixed_and_common_to_all_rules_in_any_number_of_workers(result):
    again = cc.compare(cases=[CASE], runs=3, workers=2)
    for name in set(again.data_vars) - MEASURED:
        first = result[name].sel(rule=again["rule"])
        assert first.equals(again[name]), name
    central = result["rmse_centralised"].sel(case=CASE).dropna("rule", how="all")
    assert (central == central.isel(rule=0)).all()


def test_a_rule_of_beliefs_that_are_not_numbers_is_as_good_as_no_fusion(result):
    own, alone = (result.sel(case=CASE, rule=rule) for rule in ("lost", "local"))
    np.testing.assert_allclose(own["rmse"], alone["rmse"], rtol=1e-9)


def test_an_error_is_the_root_mean_square_over_that_of_the_centralised_filter(result):
    part = result.sel(case=CASE, rule="wac")
    found = {one.rule: one for one in comparison_figures(result).cases[0].rules}["wac"]
    ratio = np.sqrt((part["rmse"] ** 2).mean() / (part["rmse_centralised"] ** 2).mean())
    value, low, high = found.to_centralised
    assert value == pytest.approx(float(ratio))
    # The interval is symmetric on the scale of logarithms.
    assert low < value < high and value / low == pytest.approx(high / value)


class Stopped(Exception):
    """Exception that ends a comparison in these tests."""


def stopping(function, arguments):
    """Compute two entries and stop."""
    for place in range(2):
        yield place, function(arguments[place])
    raise Stopped


def test_finished_entries_are_kept_and_not_computed_again(tmp_path: Path):
    entries = entries_of(asked_cases([CASE], 1), {}, None)[:5]
    with pytest.raises(Stopped):
        compute_missing(entries, {}, tmp_path, stopping, lambda _: None)
    done = kept_before(entries, tmp_path)
    assert len(done) == 2
    first = {place: figures["node_us"].item() for place, figures in done.items()}
    _, figures = compute_missing(entries, done, tmp_path, in_this_process, lambda _: None)
    assert {place: figures[place]["node_us"].item() for place in first} == first
    assert len(kept_before(entries, tmp_path)) == len(figures) > 2
    # Other runs are another comparison.
    assert not kept_before(entries_of(asked_cases([CASE], 2), {}, None), tmp_path)


def test_an_own_rule_is_computed_again_when_its_file_changes(tmp_path: Path):
    file = tmp_path / "mine.py"
    digests = []
    for text in ("RULE = print\n", "RULE = print  # changed\n"):
        file.write_text(text)
        entries = entries_of(asked_cases([CASE], 1), {"mine": f"{file}:RULE"}, None)
        digests.append({entry.rule: entry.digest for entry in entries})
    assert digests[0]["mine"] != digests[1]["mine"] and digests[0]["ci"] == digests[1]["ci"]


def test_the_command_writes_its_files_and_keeps_to_80_columns(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "my_own.py").write_text(
        "from concord.filters.fusion.averaging import covariance_intersection\n"
        "RULE = covariance_intersection\n"
    )
    out, name = tmp_path / "out", f"{tmp_path}/my_own.py:RULE"
    said = concord(capsys, "compare", "--case", f"{CASE},mrclam", "--runs", 2, "--rule", name,
                   "--workers", 1, "-o", out)  # fmt: skip
    assert said.code == 0, said.err
    assert max(map(len, said.out.splitlines())) <= 80
    for word in (*summaries("RULES"), CASE, "mrclam", "not any rule: it replays recorded data"):
        assert word in said.out, word
    html = (out / "report.html").read_text()
    assert "<img" not in html and "http" not in html and name in html
    again = concord(capsys, "compare", "--case", f"{CASE},mrclam", "--runs", 2, "--rule", name,
                    "--workers", 1, "-o", out, "--json")  # fmt: skip
    figures = json.loads(again.out)
    assert figures == json.loads((out / "compare.json").read_text())
    assert "computed before" in again.err and "runs:" not in again.err
    assert r"my\_own.py:RULE" in (out / "table.tex").read_text()
    assert all(f"| {rule} |" in (out / "table.md").read_text() for rule in summaries("RULES"))


def test_the_latex_table_has_a_row_of_ten_cells_for_every_rule_that_ran(result):
    rows = [line for line in latex(comparison_figures(result)).splitlines() if "&" in line]
    ran = int((result["reason"] == "").sum())
    assert len(rows) == 1 + ran
    assert {row.count("&") for row in rows} == {9}


@pytest.mark.slow
def test_ctrl_c_keeps_finished_entries_and_the_same_command_goes_on(tmp_path: Path):
    words = ["compare", "--case", CASE, "--runs", "6", "--workers", "2", "-o", "out"]
    kept = tmp_path / "out" / KEPT
    with family([*CONCORD, *words], tmp_path) as run:
        said = interrupted(run, lambda: list(kept.glob("*/*.npz")))
    assert "the same command goes on" in said
    count = len(list(kept.glob("*/*.npz")))
    assert count > 0 and not (tmp_path / "out" / "results.nc").exists()
    again = subprocess.run(
        [*CONCORD, *words], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert f"{count} of these were computed before" in again.stderr
    assert (tmp_path / "out" / "results.nc").exists()
