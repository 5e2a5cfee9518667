"""`concord reproduce liu2021` with few sequences: it completes, and its mutants are caught."""

import json
from pathlib import Path

import numpy as np
import pytest

from concord.experiments.__main__ import main
from concord.papers.kit.report import check_runs
from concord.papers.liu2021 import reproduce, runs
from concord.papers.liu2021.claims import claims
from concord.papers.liu2021.comparisons import Mutant, mutant_of_rule, mutant_of_sign
from concord.papers.liu2021.figures import blocks
from concord.papers.liu2021.reproduce import PAPER
from concord.papers.liu2021.runs import ESTIMATORS, simulate
from concord.papers.liu2021.tables import PUBLISHED, difference, gains_of_tables
from tests.papers.support import every_claim_can_fail

pytestmark = pytest.mark.slow


def test_table_one_is_matched_and_the_others_as_far_as_known():
    gains = gains_of_tables()
    assert difference(gains[0], PUBLISHED[0]).largest <= 6e-4
    assert difference(gains[1], PUBLISHED[1]).relative == pytest.approx(0.047, abs=5e-3)
    assert difference(gains[2], PUBLISHED[2]).largest <= 2e-3


def test_the_first_sequence_is_the_papers_whatever_the_seed():
    one, other = simulate(1, 3, 5), simulate(2, 3, 5)
    np.testing.assert_array_equal(one.states[0], other.states[0])
    assert (one.states[1:] != other.states[1:]).any()
    np.testing.assert_array_equal(simulate(1, 2, 5).states, one.states[:3])


def test_every_estimator_holds_every_sequence():
    batch = simulate(3, 12, 5)
    for name, estimate in ESTIMATORS.items():
        outcome = estimate(batch)
        assert not outcome.violations.any(), name
        # The half-widths are a consequence: the state is within them.
        error = np.abs(batch.states[:, outcome.steps] - outcome.centre.swapaxes(0, 1))
        assert (error <= outcome.half_widths.swapaxes(0, 1) * (1 + 1e-9)).all(), name


def test_estimates_by_the_cycle_are_laid_out_step_by_step():
    batch = simulate(1, 0, 4)
    for name in ("paper", "tight"):
        centre, width = blocks(ESTIMATORS[name](batch))
        assert (np.abs(batch.states[0, 1:] - centre) <= width * (1 + 1e-9)).all()


MEASURED = dict(
    outside=0, instants=2613, largest=0.98, flipped=Mutant(37, 270, 130, 2613, 201),
    wrong_rule=Mutant(23, 101, 45, 2613, 201), rank=4, size=14, apart=(5.7e-4, 0.35, 1.9e-3),
    relative=(3e-4, 0.047, 2.1e-3), winners=(4, 3, 3), tables_need=4, agreeing=1,
)  # fmt: skip


def test_claims_get_the_verdicts_that_the_figures_say():
    verdicts = {claim.where: claim.verdict for claim in claims(MEASURED)}
    assert verdicts == {
        "Theorem 1": "holds",
        "(20), (31)": "holds",
        "(18)": "does not hold",
        "Table I": "holds",
        "Tables II, III": "does not hold",
        "(5), Tables II, III": "contradicts itself",
    }


def test_every_claim_can_fail():
    every_claim_can_fail(claims, MEASURED)


@pytest.mark.slow
def test_both_mutants_violate():
    for mutant in (mutant_of_sign(simulate(1, 60, 13)), mutant_of_rule(1, 60, 13)):
        assert mutant.outside > 0


@pytest.mark.study
def test_the_command_writes_its_report_and_figures(tmp_path: Path, capsys):
    folder = tmp_path / "liu2021"
    main(["reproduce", "liu2021", "--runs", "40", "--out", str(folder), "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["ok"]
    assert {f"figure-{number}.png" for number in range(2, 10)} <= {p.name for p in folder.iterdir()}
    text = (folder / "report.md").read_text(encoding="utf-8")
    assert "Table II, ours (printed)" in text


def test_no_sequences_are_refused():
    with pytest.raises(ValueError, match="at least 1"):
        check_runs(PAPER, 0)


def test_a_prior_that_is_too_small_fails_its_check(monkeypatch: pytest.MonkeyPatch):
    starts, _ = runs.initial_and_noise(1, 20, 1)
    assert all(check.ok for check in reproduce.prior_checks(starts))
    monkeypatch.setattr(reproduce, "PRIOR_SHAPE", 0.9**2 * reproduce.PRIOR_SHAPE)
    assert not any(check.ok for check in reproduce.prior_checks(starts))


def test_the_trace_of_the_fast_form_is_pinned():
    batch = runs.simulate(5, 0, reproduce.CYCLES)
    fast = runs.ESTIMATORS["fast"](batch).trace[:, 0].mean()
    assert fast == pytest.approx(reproduce.FAST_TRACE, rel=1e-4)
