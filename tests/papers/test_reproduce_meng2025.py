"""The reproduction of Meng et al. (2025): runs as elsewhere, figures as in another study."""

import struct
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray

from concord.features.measurement_bus import meng2025_plant as meng2025
from concord.features.measurement_bus.meng2025 import SYSTEM
from concord.papers.kit.judging import NamedFigures
from concord.papers.kit.report import check_runs
from concord.papers.meng2025.claims import claims, gather, order_of_slots
from concord.papers.meng2025.particles import log_likelihood, track
from concord.papers.meng2025.reproduce import PAPER, checks_of
from concord.papers.meng2025.runs import (
    ComparedMethod,
    MeasuredBatch,
    SlotEstimates,
    methods,
    ranks_of_printed_cov,
    simulate,
)
from concord.papers.meng2025.runs import carry_out as estimate_by
from concord.papers.meng2025.table import EstimatorRow, row
from concord.papers.reproduce import carry_out
from concord.results.figures.intervals import Interval
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario
from tests.papers.support import every_claim_can_fail

pytestmark = pytest.mark.slow

# RMSE x1, x2 and ANEES over 200 runs of an independent implementation (the study of the paper).
STUDY = {
    "recommended": (0.243, 0.220, 2.06),
    "paper-literal": (0.829, 0.603, 15.7),
    "paper-literal-R": (0.437, 0.354, 4.6),
    "ignorant": (0.244, 0.220, 2.31),
    "alpha": (0.243, 0.220, 2.09),
    "all": (0.115, 0.099, 2.18),
    "wtodp": (0.226, 0.190, 2.01),
    "round-robin": (0.255, 0.221, 2.20),
    "rrp": (0.255, 0.253, 2.42),
    "prediction": (0.497, 0.426, 2.02),
}
# Intervals are 1.97 standard errors to either side; two studies differ by sqrt(2) of one's.
STUDIES_APART = 3 * np.sqrt(2) / 1.97


@pytest.fixture(scope="module")
def batch() -> MeasuredBatch:
    return simulate(1, 200, 100)


@pytest.fixture(scope="module")
def outcomes(batch: MeasuredBatch) -> dict[str, SlotEstimates]:
    found = {name: estimate_by(batch, method) for name, method in methods().items()}
    return found | {"particles": track(batch, methods()["recommended"].schedule, particles=200)}


@pytest.fixture(scope="module")
def rows(batch: MeasuredBatch, outcomes: dict[str, SlotEstimates]) -> dict[str, EstimatorRow]:
    ours = outcomes["recommended"]
    return {
        name: row(name, name, batch, outcome, None if outcome is ours else ours)
        for name, outcome in outcomes.items()
    }


def half(one: Interval) -> float:
    return (one.high - one.low) / 2


# --- the runs ------------------------------------------------------------------------------------


def test_a_run_of_the_batch_is_that_run_of_the_scenario():
    few = simulate(5, 3, 30)
    outcome = estimate_by(few, methods()["recommended"])
    setup = prepare(scenario("meng2025", seed=5, run=2, steps=31))
    trace = read_trace(setup, in_memory(setup))
    np.testing.assert_allclose(trace.truth, few.truth[:, 2], rtol=1e-12, atol=1e-12)
    readings = trace.readings[:, 1:, 0, 0]
    np.testing.assert_allclose(readings, few.measurement[:, 2], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(trace.published[1:, 0, 1:], outcome.sent[:, 2])
    np.testing.assert_allclose(trace.mean[:, 0], outcome.mean[:, 2], rtol=1e-9, atol=1e-9)


def test_a_run_does_not_depend_on_how_many_there_are():
    np.testing.assert_array_equal(simulate(4, 5, 20).truth[:10, :2], simulate(4, 2, 9).truth)


@pytest.mark.parametrize("name", STUDY)
def test_figures_are_those_of_the_study(name: str, rows: dict[str, EstimatorRow]):
    first, second, anees = STUDY[name]
    found = rows[name]
    assert found.diverged == 0
    for measured, published in zip(found.rmse, (first, second), strict=True):
        assert abs(measured.value - published) < STUDIES_APART * half(measured) + 0.0005
    assert found.anees is not None
    assert abs(found.anees.value - anees) < STUDIES_APART * half(found.anees) + 0.05


def test_the_ranking_is_significant(rows: dict[str, EstimatorRow]):
    for name, sign in (("wtodp", -1), ("all", -1), ("rrp", 1), ("prediction", 1)):
        difference = rows[name].difference
        assert difference is not None
        assert sign * difference.value > half(difference)
    assert rows["paper-literal"].mse.low > rows["prediction"].mse.high


@pytest.mark.parametrize(
    ("shifted", "published"),
    [
        ({"measure": lambda x, s: meng2025.measure(x, s - 1)}, (0.324, 0.271)),
        ({"transition": lambda x, u, s: meng2025.transition(x, u, s + 1)}, (0.303, 0.249)),
    ],
    ids=["h", "f"],
)
def test_time_off_by_one_costs_what_the_study_says(
    batch: MeasuredBatch,
    outcomes: dict[str, SlotEstimates],
    shifted: dict,
    published: tuple[float, float],
):
    """So the test of the figures would fail if f or h were off by one."""
    method = methods()["recommended"]._replace(system=replace(SYSTEM, **shifted))
    found = row("off", "off", batch, estimate_by(batch, method), outcomes["recommended"])
    for measured, value in zip(found.rmse, published, strict=True):
        assert abs(measured.value - value) < STUDIES_APART * half(measured) + 0.0005
    ours, limit = found.rmse[0].value, STUDY["recommended"][0]
    assert ours > 1.15 * limit
    assert found.difference is not None and found.difference.low > 0


def test_printed_ranks(batch: MeasuredBatch):
    few = MeasuredBatch(1, batch.truth[:, :10], batch.measurement[:, :10])
    ranks = ranks_of_printed_cov(few)
    assert ranks.shape == (100, 10)
    assert ranks.max() == 5


# --- particles -----------------------------------------------------------------------------------


def test_the_likelihood_is_that_of_a_gaussian_given_the_state():
    generator = np.random.default_rng(1)
    states, values = generator.standard_normal((3, 40, 2)), generator.standard_normal((3, 6))
    sent = np.eye(6, dtype=bool)[[0, 4, 5]]
    found = log_likelihood(states, values, sent, 7)
    outer = np.array([0.3, 0.2, 0.1, 0.1, 0.2, 0.3])
    for run, sensor in enumerate((0, 4, 5)):
        for particle in range(40):
            x = states[run, particle]
            variance = 0.01 + outer[sensor] ** 2 * (0.04 * x[0] ** 2 + 0.09 * x[1] ** 2)
            error = values[run, sensor] - meng2025.measure(x, 7)[sensor]
            expected = -0.5 * (error**2 / variance + np.log(variance))
            assert found[run, particle] == pytest.approx(expected, rel=1e-12)


def test_particles_are_no_worse_than_the_recommended_filter(rows: dict[str, EstimatorRow]):
    # Two hundred particles only: of two thousand the study says 3 % better.
    difference = rows["particles"].difference
    assert difference is not None
    assert difference.value < 0.02


# --- the table -----------------------------------------------------------------------------------


def test_figures_of_errors_that_are_what_is_reported():
    generator = np.random.default_rng(3)
    steps, runs = 100, 300
    root = np.array([[0.5, 0.0], [0.3, 0.2]])
    errors = generator.standard_normal((steps + 1, runs, 2)) @ root.T
    truth = np.zeros((steps + 1, runs, 2))
    cov = np.broadcast_to(root @ root.T, (steps + 1, runs, 2, 2))
    known = MeasuredBatch(1, truth, truth)
    found = row("a", "a", known, SlotEstimates(errors, cov, np.empty(0)), None)
    assert found.anees is not None and found.coverage is not None
    for one, expected in (
        (found.anees, 2.0), (found.coverage, 0.95), (found.mse, np.trace(root @ root.T)),
        (found.rmse[0], 0.5), (found.rmse[1], np.hypot(0.3, 0.2)),
    ):  # fmt: skip
        assert abs(one.value - expected) < 2 * half(one)
    assert found.mse_to_trace == pytest.approx(1.0, abs=0.02)
    assert found.difference is None


def test_runs_that_diverge_are_counted_and_left_out():
    truth = np.zeros((5, 4, 2))
    mean, cov = np.full((5, 4, 2), 0.1), np.broadcast_to(np.eye(2), (5, 4, 2, 2))
    sound = SlotEstimates(mean, cov, np.empty(0))
    lost = mean.copy()
    lost[3, 1], lost[4, 2, 0] = np.nan, 2e3
    found = row(
        "a", "a", MeasuredBatch(1, truth, truth), SlotEstimates(lost, cov, np.empty(0)), sound
    )
    assert found.diverged == 0.5
    assert found.largest_error == pytest.approx(0.1)
    assert found.difference == Interval(0.0, 0.0, 0.0)


# --- the report ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def evidence(
    batch: MeasuredBatch, outcomes: dict[str, SlotEstimates], rows: dict[str, EstimatorRow]
) -> NamedFigures:
    return gather(batch, outcomes, rows)


def test_claims_get_the_verdicts_that_the_figures_say(evidence: NamedFigures):
    found = {claim.says: claim.verdict for claim in claims(evidence)}
    assert found == {
        "the gain is P_xy P_yy^-1": "contradicts itself",
        "the impact of the protocol is reflected in the filter": "does not hold",
        "the estimates follow the states": "does not hold",
        "log MSE is consistently below the log of its upper bound": "does not hold",
        "the impact of the stochastic nonlinearities is reflected in the filter": "holds",
        "FlexRay has advantages over other protocols": "does not hold",
    }


def test_every_claim_can_fail(evidence: NamedFigures):
    every_claim_can_fail(claims, evidence)


def test_bands_come_from_the_runs_own_intervals(rows: dict[str, EstimatorRow]):
    exact = {check.name: check for check in checks_of(200, rows)}
    assert all(check.ok for check in exact.values())
    ours = rows["recommended"]
    far = msgspec.structs.replace(
        ours, rmse=[Interval(1.2 * i.value, 1.2 * i.low, 1.2 * i.high) for i in ours.rmse]
    )
    worse = {check.name: check for check in checks_of(200, rows | {"recommended": far})}
    assert not worse["recommended: RMSE x1"].ok


def test_the_order_of_slots(outcomes: dict[str, SlotEstimates]):
    assert order_of_slots(outcomes["recommended"], 10) == "1 2 3 4 d 1 2 3 4 d"
    assert order_of_slots(outcomes["round-robin"], 4) == "1 2 3 4"


def test_the_whole_reproduction(tmp_path: Path):
    report = carry_out("meng2025", PAPER, tmp_path, seed=7, runs=12)
    assert report.complete and (report.seed, report.runs) == (7, 12)
    assert [section.title for section in report.sections] == [
        "Claims", "Errata", "Figures", "Comparison", "Checks", "One erratum at a time",
    ]  # fmt: skip
    text = (tmp_path / "report.md").read_text()
    for number in range(2, 6):
        assert f"](figure-{number}.png)" in text
        picture = (tmp_path / f"figure-{number}.png").read_bytes()
        width, height = struct.unpack(">II", picture[16:24])
        assert width > 1000 and height > 400
        assert (tmp_path / f"figure-{number}.svg").read_text().startswith("<?xml")
    labels = [method.label for method in methods().values()]
    assert all(label in text for label in labels)
    assert report.sections[3].data["rows"]["recommended"]["name"] == "recommended"
    with xarray.open_dataset(tmp_path / "traces.nc", engine="h5netcdf") as traces:
        assert traces["mean"].sizes == {"estimator": 11, "step": 101, "run": 12, "state": 2}
        np.testing.assert_array_equal(traces["truth"], simulate(7, 12, 100).truth)


@pytest.mark.slow
def test_every_check_holds_over_the_runs_of_the_study(tmp_path: Path):
    done = carry_out("meng2025", PAPER, tmp_path, PAPER.seed, PAPER.runs)
    failed = [c.name for section in done.sections for c in section.checks if not c.ok]
    assert not failed


def test_one_run_cannot_be_compared():
    with pytest.raises(ValueError, match="--runs 1: must be at least 2"):
        check_runs(PAPER, 1)


def test_methods_differ_from_the_first_in_one_thing():
    first, *others = methods().values()
    for method in others:
        changed = [
            field
            for field in ComparedMethod._fields
            if field != "label" and getattr(method, field) != getattr(first, field)
        ]
        assert len(changed) == 1, method.label
