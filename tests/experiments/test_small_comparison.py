"""A comparison of three rules on two small cases: figures, order, reasons, tables and files."""

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from concord.results.figures.intervals import Interval
from concord.scenarios.preparation import prepare
from concord.studies.compare import entries as entries_module
from concord.studies.compare.entries import asked_cases, entries_of
from concord.studies.compare.output import write_comparison
from concord.studies.compare.results import CaseFigures, RuleFigures, assemble, comparison_figures
from concord.studies.compare.run import compute_missing, kept_before
from concord.studies.compare.suite import Case
from concord.studies.compare.tables import (
    cells_of_rule,
    latex,
    overviews,
    page,
    print_comparison,
    rules_of,
)
from concord.studies.monte_carlo.simulate import simulate
from concord.studies.sweep.workers import in_this_process
from tests.experiments.support import scenario

OPTIONS = {"scenario": "oscillator", "nodes": "3", "steps": "30", "seed": "1"}
CASES = (
    Case("ring", "three nodes in a ring", {**OPTIONS, "graph": "ring"}, 4),
    Case("path", "three nodes on a path", {**OPTIONS, "graph": "path"}, 2),
)
RULES = {"local": "no fusion", "ci": "averages", "centralised": "one filter hears all"}
UNKNOWN = Interval(np.nan, np.nan, np.nan)


@pytest.fixture(scope="module", autouse=True)
def few_rules():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(entries_module, "suite", lambda: CASES)
        patched.setattr(entries_module, "summaries", lambda _: RULES)
        yield


@pytest.fixture(scope="module")
def computed():
    entries = entries_of(asked_cases(None, None), {}, None)
    runs: list[int] = []
    entries, figures = compute_missing(entries, {}, None, in_this_process, runs.append)
    # Entries that cannot run count no run.
    assert runs == [0, 4, 8, 10, 12]
    return assemble(entries, figures)


def test_cases_and_rules_stand_where_their_names_say(computed):
    assert computed["case"].to_numpy().tolist() == ["ring", "path"]
    assert computed["rule"].to_numpy().tolist() == list(RULES)
    assert computed["runs"].to_numpy().tolist() == [4, 2]
    assert dict(computed["rmse"].sizes) == {"case": 2, "rule": 3, "run": 4}
    known = np.isfinite(computed["rmse"].to_numpy())
    assert known[0].all(axis=1).tolist() == [True, True, False]
    assert known[1].tolist() == [[True, True, False, False]] * 2 + [[False] * 4]
    for place, case in enumerate(CASES):
        asked = scenario(nodes=3, steps=30, graph=case.name, seed=1, rule="ci")
        runs = simulate(prepare(asked), range(case.runs))
        errors = (runs.mean - runs.truth[:, :, None])[:, 20:]
        states = computed["rmse"].sel(rule="ci").to_numpy()[place, : case.runs]
        expected = np.sqrt((errors[..., :1] ** 2).sum(-1).mean(axis=(1, 2)))
        np.testing.assert_allclose(states, expected, rtol=1e-9)


def test_rules_are_ordered_by_their_errors_over_those_of_the_same_filter(computed):
    found = comparison_figures(computed)
    assert [case.runs for case in found.cases] == [4, 2]
    for case in found.cases:
        ran = [one for one in case.rules if not one.reason]
        assert [one.rule for one in case.rules][2] == "centralised"
        assert case.rules[2].reason and np.isnan(case.rules[2].to_centralised.value)
        ratios = [one.to_centralised.value for one in ran]
        assert ratios == sorted(ratios) and [one.rule for one in ran] == ["ci", "local"]
        part = computed.sel(case=case.case).isel(run=slice(0, case.runs))
        for one in ran:
            own = part.sel(rule=one.rule)
            squares = (own["rmse"] ** 2).mean() / (own["rmse_centralised"] ** 2).mean()
            assert one.to_centralised.value == pytest.approx(float(np.sqrt(squares)))
            assert one.anees.value == pytest.approx(float(own["anees"].mean()))
            assert one.node_ratio == one.node_us / min(other.node_us for other in ran)
        assert min(one.node_ratio for one in ran) == 1
    assert all(case.options == {**OPTIONS, "graph": case.case} for case in found.cases)


def test_an_entry_that_was_computed_is_kept_for_the_same_entry_alone(tmp_path: Path):
    entries = entries_of(asked_cases(["path"], 1), {}, None)
    again, figures = compute_missing(entries, {}, tmp_path, in_this_process, lambda _: None)
    kept = kept_before(again, tmp_path)
    assert kept.keys() == figures.keys() == {0, 1}
    for place, arrays in kept.items():
        assert arrays.keys() == figures[place].keys()
        for name, values in arrays.items():
            np.testing.assert_array_equal(values, figures[place][name])
    runs: list[int] = []
    compute_missing(entries, dict(kept), tmp_path, in_this_process, runs.append)
    assert runs == []
    assert kept_before(entries_of(asked_cases(["path"], 2), {}, None), tmp_path) == {}
    assert kept_before(entries, None) == {}


def test_a_rule_that_fails_gives_its_reason_and_the_others_go_on():
    def engine(function, arguments):
        yield 0, "ZeroDivisionError: no neighbour"
        yield 1, function(arguments[1])

    entries = entries_of(asked_cases(["path"], 1), {}, None)
    entries, figures = compute_missing(entries, {}, None, engine, lambda _: None)
    assert entries[0].reason == "ZeroDivisionError: no neighbour" and figures.keys() == {1}


def test_tables_have_each_rule_that_ran_and_the_reasons_of_the_others(computed, tmp_path: Path):
    figures = comparison_figures(computed)
    write_comparison(computed, figures, tmp_path)
    names = ["compare.json", "report.html", "results.nc", "table.md", "table.tex"]
    assert sorted(one.name for one in tmp_path.iterdir()) == names
    rows = [line for line in latex(figures).splitlines() if "&" in line]
    assert [row.split("&")[1].strip() for row in rows] == ["rule", "ci", "local", "ci", "local"]
    assert {row.count("&") for row in rows} == {9}
    told = json.loads((tmp_path / "compare.json").read_text())
    assert [case["case"] for case in told["cases"]] == ["ring", "path"]
    assert told["cases"][0]["rules"][2]["to_centralised"] == [None] * 3
    markdown = (tmp_path / "table.md").read_text()
    assert markdown.count("| rule | ring | path |") == len(overviews(figures)) / 2 == 5
    html = (tmp_path / "report.html").read_text()
    assert "3 fusion rules on 2 cases" in html and "--scenario oscillator --nodes 3" in html
    console = Console(width=80, record=True, file=StringIO())
    print_comparison(figures, console)
    said = console.export_text()
    assert "ring: three nodes in a ring; 4 runs" in said and "not centralised: " in said
    assert len(page(figures)) > len(overviews(figures)) + 2 * 3


def rule_figures(rule: str, error: float, **changes: object) -> RuleFigures:
    known = Interval(error, error / 2, 2 * error)
    usual = {
        "rule": rule, "level": "WORKS", "to_centralised": known, "anees": Interval(1.0, 0.5, 1.9),
        "bytes_per_step": Interval(1234.5, 1.0, 2.0), "bus_time_us": Interval(2.5e6, 1.0, 2.0),
        "node_us": 3.0, "node_ratio": 1.5, "reason": "",
    }  # fmt: skip
    return RuleFigures(**{**usual, **changes})  # type: ignore[arg-type]


def test_cells_show_three_digits_half_an_interval_and_the_level_of_what_fails():
    expected = ("1.23", "0.617..2.47", "1", "0.7", "1234", "2.5e+06", "1.5", "")
    assert cells_of_rule(rule_figures("ci", 1.2345)) == expected
    unknown = rule_figures("ci", 1.0, to_centralised=UNKNOWN, anees=UNKNOWN, level="CHECK")
    assert cells_of_rule(unknown)[:4] == ("-",) * 4 and cells_of_rule(unknown)[-1] == "CHECK"


def test_rules_of_all_cases_stand_in_the_order_of_their_median_error(computed):
    """Rule b is first twice of three times; rule c ran nowhere."""
    cases = [
        CaseFigures("x", "", {}, 1, [rule_figures(name, error) for name, error in errors])
        for errors in (
            [("a", 1.0), ("b", 9.0), ("c", np.nan)],
            [("b", 1.5), ("a", 3.0), ("c", np.nan)],
            [("b", 1.6), ("a", 4.0), ("c", np.nan)],
        )
    ]
    figures = comparison_figures(computed)
    assert rules_of(type(figures)(cases, {}, "")) == ["b", "a", "c"]
