"""`concord run --driver batched`: the figures of the runs one by one, with intervals."""

from pathlib import Path

import numpy as np
import pytest
import xarray

from concord.results.figures.figure_table import FIGURES, RATIOS
from concord.results.figures.intervals import positive_mean_t, ratio_t
from concord.results.figures.summary import summarise
from concord.results.records.runs import Runs
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import setup_of_run
from concord.studies.monte_carlo.simulate import AGES, INNOVATIONS, READINGS, simulate
from tests.experiments.command_support import Said, concord
from tests.experiments.support import small, summary_of
from tests.features.rows import rows_of_features

RUNS = range(2, 5)
SETUPS = {
    "tracking": small("target-tracking", nodes=5, steps=24, schedule="hybrid", occupancy=0.5),
    "interacting models": small("target-tracking", steps=12, filter="imm"),
    **{name: small(name, **rest) for name, rest in rows_of_features("SMALL_NETWORKS").items()},
}


@pytest.mark.parametrize("name", SETUPS)
def test_figures_of_many_runs_follow_from_those_of_each(name: str):
    """By messages one by one, and as arrays: the same names, and means over the runs."""
    own = [setup_of_run(SETUPS[name], run) for run in RUNS]
    each = [summary_of(one, read_trace(one, in_memory(one))) for one in own]
    found = summarise(simulate(SETUPS[name], RUNS, keep=(READINGS, AGES, INNOVATIONS)))
    assert [one.figures.keys() for one in each] == [found.figures.keys()] * len(each)
    for figure, interval in found.figures.items():
        values = np.array([one.value(figure) for one in each])
        if figure in RATIOS:
            ratio = RATIOS[figure]
            one, other = (np.array([o.value(n) for o in each]) for n in (ratio.one, ratio.other))
            if other.max() < 1e-9 * one.max():
                # The readings tell the state exactly: the denominator is rounding.
                continue
            expected = ratio_t(one**2, other**2)
        elif FIGURES[figure].statistic == "rms":
            expected = ratio_t(values**2, np.ones_like(values))
        else:
            expected = positive_mean_t(values)
        np.testing.assert_allclose(interval, expected, rtol=1e-6, atol=1e-12, err_msg=figure)
    for node, figures in enumerate(found.nodes):
        for figure in ("anees", "sent", "heard", "missed", "rejected"):
            mean = np.mean([one.nodes[node][figure].value for one in each])
            assert figures[figure].value == pytest.approx(mean, nan_ok=True)


def test_a_large_network_has_a_centralised_filter_too():
    """That takes readings one by one: of a linear plant the same as the filter of all."""
    setup = small(nodes=207, steps=3, graph="ring", bus="ideal")
    histories = simulate(setup, [0])
    figures = summarise(histories)
    assert 0 < figures.value("rmse_centralised") < figures.value("rmse")
    assert histories.readings is not None
    belief = centralised_of_runs(setup, [0], histories.readings, None)
    information = np.linalg.inv(setup.prior_cov)
    vector = information @ setup.prior_mean
    for node, (reading,) in enumerate(histories.readings[0, 0]):
        sensor = definition_named("oscillator").sensor(setup.scenario, node)
        if sensor is not None and not np.isnan(reading).any():
            value, noise_cov = sensor.interpret(reading)
            row = sensor.measure(np.eye(2), 0).T
            information = information + row.T @ row / noise_cov[0, 0]
            vector = vector + row[0] * value[0] / noise_cov[0, 0]
    np.testing.assert_allclose(belief.cov[0, 0], np.linalg.inv(information), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(belief.mean[0, 0], np.linalg.solve(information, vector), rtol=1e-7)


def run(capsys: pytest.CaptureFixture[str], *options: object) -> Said:
    return concord(capsys, "run", "--scenario", "oscillator", "--nodes", 4, "--steps", 9, *options)


def test_the_command_writes_arrays_by_run_and_prints_intervals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    options = ("--driver", "batched", "--runs", "3", "--run", "2", "--covariances", "--json")
    said = run(capsys, *options, "--out", tmp_path / "many").json()
    assert said["runs"] == 3 and said["first_run"] == 2
    value, low, high = said["rmse"]
    assert low < value < high
    assert said["node_updates_per_second"] > 0 and said["peak_memory_mb"] > 10
    with xarray.open_dataset(tmp_path / "many" / "run.nc") as dataset:
        assert dict(dataset["mean"].sizes) == {"run": 3, "step": 9, "node": 4, "state": 2}
        assert dataset["run"].values.tolist() == [2, 3, 4]
        assert dataset["cov"].dims == ("run", "step", "node", "state", "other_state")
        assert dataset.attrs["driver"] == "batched"
        ages = dataset["ages"].values
    setup = small(steps=9, run=2)
    kept: Runs = simulate(setup, range(2, 5))
    np.testing.assert_array_equal(ages, kept.ages)


def test_an_interrupted_monte_carlo_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("concord.experiments.run_many.simulate", interrupted)
    said = run(capsys, "--driver", "batched", "--out", tmp_path / "many")
    assert said.code == 130 and "is removed" in said.err
    assert not (tmp_path / "many").exists()
