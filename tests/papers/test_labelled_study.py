"""The study of labelled measurements: its statistics, its cases, and its report."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from concord.experiments.cli.reproduce import carry_out
from concord.papers.labelled import reproduce, study
from concord.papers.labelled.cases import CaseOutcome, FaultCase, halves, runs_of_case
from concord.papers.labelled.cases_section import CASES, cases_section
from concord.papers.labelled.reproduce import PAPER, error_section, figure_of
from concord.papers.labelled.study import FORMS, OCCUPANCIES, Form, RunOutcome, StudyJob, cell
from concord.papers.labelled.study import outcomes as runs_of
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_of

pytestmark = pytest.mark.slow


def outcomes(generator: np.random.Generator, runs: int) -> list[RunOutcome]:
    central = generator.chisquare(20, runs) / 20
    network = central * generator.normal(1.44, 0.1, runs)
    return [
        RunOutcome(n, c, np.array([1.0, 1.1]) + c, 1.0 * c, 100.0, 200.0, 300.0, 0.9, 0.1)
        for n, c in zip(network, central, strict=True)
    ]


def test_the_interval_is_that_of_the_delta_method():
    found = outcomes(np.random.default_rng(0), 400)
    squared = np.array([[o.squared, o.squared_centralised] for o in found])
    mean, cov = squared.mean(0), np.cov(squared.T) / len(found)
    ratio = np.sqrt(mean[0] / mean[1])
    slope = 0.5 * ratio / mean * [1, -1]
    half_width = stats.t.ppf(0.975, 399) * np.sqrt(slope @ cov @ slope)
    result = cell(found)
    assert result.ratio == pytest.approx(ratio)
    assert (result.error.high - result.error.low) / 2 == pytest.approx(half_width, rel=0.02)
    assert result.error.high * result.error.low == pytest.approx(ratio**2)
    # The worst node is 0.1 above the centralised filter, which is paired with it.
    assert result.excess == pytest.approx(1.1) and result.excess_half_width < 1e-9


def test_a_run_is_what_a_summary_would_say():
    form = Form("labelled", {"rule": "labelled", "schedule": "dynamic", "steps": 30})
    (found, _) = runs_of(StudyJob(form, 0.25, 1, 2))
    assert 1.0 < np.sqrt(found.squared / found.squared_centralised) < 3.0
    assert found.consistency.shape == (20,)
    # Fifteen frames a step at most, each of at least ten bytes and at most 254, and 8 around.
    assert 0 < found.said_bytes < found.wire_bytes <= 15 * 262
    assert found.wire_us > 0.8 * found.wire_bytes


def test_the_halves_of_the_cut_hang_together():
    setup = prepare(scenario_of(scenario="target-tracking", nodes=20))
    side = halves(setup)
    assert side.sum() == 8
    for part in (side, ~side):
        members = set(np.flatnonzero(part).tolist())
        reached, frontier = set(), [min(members)]
        while frontier:
            node = frontier.pop()
            reached.add(node)
            frontier += [j for j in setup.neighbours[node] if j in members - reached]
        assert reached == members


def test_a_case_loses_what_it_says():
    options = {"occupancy": 1.0, "steps": 12}
    (clean,), (lossy,) = (
        runs_of_case(FaultCase({**options, "loss": loss}), 1) for loss in (0.0, 0.8)
    )
    assert lossy.squared[6:].mean() > 1.5 * clean.squared[6:].mean()
    np.testing.assert_array_equal(clean.squared_centralised, lossy.squared_centralised)


def test_the_report_has_a_picture_and_a_row_for_every_cell(tmp_path: Path):
    generator = np.random.default_rng(1)
    table = {(f.name, part): cell(outcomes(generator, 5)) for f in FORMS for part in OCCUPANCIES}
    figure_of(table).savefig(tmp_path / "labelled.png")
    assert (tmp_path / "labelled.png").stat().st_size > 10_000
    section = error_section(table, 5)
    assert section.text.count("\n| ") == 1 + 1 + len(table)
    assert not all(check.ok for check in section.checks)
    squared = generator.chisquare(2, (120, 20))
    squared[70, 13] = np.nan
    one = CaseOutcome(squared, squared / 2, squared.mean(1), 400.0, 80, 75, 1500, 2)
    section = cases_section({name: [one, one] for name in CASES})
    assert not all(check.ok for check in section.checks)
    text = section.text
    assert all(name in text for name in CASES) and "| - |" in text


def outcomes_at_a_quarter(seed: int, runs: int) -> Iterator[tuple[str, list[CaseOutcome]]]:
    """Every case by name, with the runs of the case of its kind at a quarter of the bus."""
    of_kind = {
        name.rpartition(", ")[0]: runs_of_case(case, runs, seed)
        for name, case in CASES.items()
        if name.endswith(", 0.25")
    }
    yield from ((name, of_kind[name.rpartition(", ")[0]]) for name in CASES)


@pytest.mark.slow
def test_the_command_does_all_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Two runs say little of errors; what is exact must hold all the same.

    `tests/scenarios/test_labelled.py` tries all networks. One of four occupancies is enough here,
    and of three occupancies of a special case: the report of the others repeats its outcome.
    """
    monkeypatch.setattr(reproduce, "NETWORKS", 3)
    monkeypatch.setattr(study, "OCCUPANCIES", OCCUPANCIES[-1:])
    monkeypatch.setattr(reproduce, "case_outcomes", outcomes_at_a_quarter)
    report = carry_out("labelled", PAPER, tmp_path, PAPER.seed, 2)
    assert report.complete and [section.place for section in report.sections] == [1, 2, 3]
    assert all(check.ok for check in report.sections[0].checks)
    assert (tmp_path / "labelled.png").exists()
    assert all(form.name in (tmp_path / "report.md").read_text() for form in FORMS)
