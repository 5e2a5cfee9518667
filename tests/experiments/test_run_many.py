"""`concord run --driver batched`: the figures of the runs one by one, with intervals."""

from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.stats import t

from concord.results.figures.summary import Figures
from concord.results.figures.summary import summarise as summarise_one
from concord.results.records.histories import Histories, RunCost
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.baselines import centralised_of_runs
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import setup_of_run
from concord.scenarios.setup import Setup
from concord.studies.monte_carlo.many_figures import lines, summarise
from concord.studies.monte_carlo.simulate import simulate
from tests.experiments.command_support import Said, concord
from tests.experiments.support import small

RUNS = range(2, 5)
SETUPS = {
    "tracking": small("target-tracking", nodes=5, steps=24, schedule="hybrid", occupancy=0.5),
    "a controlled plant": small("dc-motor-speed", steps=12, loss=0.2),
    "sets": small("liu2021-network", steps=4),
    "several targets": small("target-swarm", targets=3, clutter=2, steps=10, rounds=2),
    "interacting models": small("target-tracking", steps=12, filter="imm"),
}


def one_by_one(setup: Setup) -> list[Figures]:
    own = [setup_of_run(setup, run) for run in RUNS]
    return [summarise_one(one, read_trace(one, in_memory(one))) for one in own]


@pytest.mark.parametrize("name", SETUPS)
def test_figures_are_means_of_those_of_the_runs(name: str):
    expected = one_by_one(SETUPS[name])
    found = summarise(simulate(SETUPS[name], RUNS), RunCost(2.0, 100.0))
    for figure in (
        "rmse",
        "rmse_local_only",
        "rmse_centralised",
        "worst_node_to_centralised",
        "disagreement",
        "anees",
        "anees_centralised",
    ):
        values = np.array([getattr(one, figure) for one in expected])
        interval = getattr(found, figure)
        np.testing.assert_allclose(interval.value, values.mean(), rtol=1e-8, err_msg=figure)
        relative = values.std(ddof=1) / values.mean() / np.sqrt(len(values))
        half = t.ppf(0.975, len(values) - 1) * relative
        for grown in (interval.high / interval.value, interval.value / interval.low):
            np.testing.assert_allclose(np.log(grown), half, rtol=1e-6, err_msg=figure)
    for node, figures in enumerate(found.nodes):
        each = [one.nodes[node] for one in expected]
        assert figures.rmse.value == pytest.approx(np.mean([one.rmse for one in each]))
        for traffic in ("sent", "heard", "missed", "rejected"):
            mean = np.mean([getattr(one, traffic) for one in each])
            assert getattr(figures, traffic) == pytest.approx(mean)
    assert found.shares_sent == pytest.approx(np.mean([one.shares_sent for one in expected]))
    buses = [one.bus for one in expected if one.bus is not None]
    assert len(buses) == len(expected)
    assert found.bus_load.value == pytest.approx(np.mean([bus.bus_load for bus in buses]))
    # The padding of a static slot is on the wire as well.
    wire_bytes = np.mean([bus.bytes_per_step for bus in buses])
    assert 0.5 * wire_bytes < found.bytes_per_step.value <= wire_bytes * (1 + 1e-12)
    assert f"bus load {100 * found.bus_load.value:.3g} %" in "".join(lines(found))


def test_a_large_network_has_a_centralised_filter_too():
    """That takes readings one by one: of a linear plant the same as the filter of all."""
    setup = small(nodes=207, steps=3, graph="ring", bus="ideal")
    histories = simulate(setup, [0])
    figures = summarise(histories, RunCost(1.0, 1.0))
    assert 0 < figures.rmse_centralised.value < figures.rmse.value
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
    kept: Histories = simulate(setup, range(2, 5))
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
