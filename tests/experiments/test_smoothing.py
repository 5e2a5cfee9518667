"""`--smooth`: a reference from the readings of the whole run, in smoothed.nc and in the figures."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray

from concord.experiments.__main__ import main
from concord.filters.gaussian import Gaussian
from concord.results.records.trace import read_trace
from concord.results.smoothing import (
    SMOOTHED,
    Smoothed,
    smoothed_of,
    smoothing_figures,
)
from concord.runtime.drivers import in_memory
from concord.scenarios.catalogue import definition_of, scored_nees
from concord.scenarios.preparation import prepare
from tests.experiments.support import scenario


def run(*options: str) -> None:
    main(["run", *options])


def test_the_file_has_both_beliefs_and_the_figures_tell_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    asked = "--scenario oscillator --rule local --nodes 4 --steps 60 --smooth --json"
    run(*asked.split(), "--out", str(tmp_path / "run"))
    told = json.loads(capsys.readouterr().out)["smoothing"]
    assert told["rmse"] < told["rmse_filtered"]
    with xarray.open_dataset(tmp_path / "run" / SMOOTHED, engine="h5netcdf") as found:
        arrays = {name: found[name].values for name in found}
        assert found.attrs["filter"] == "ukf"
    with xarray.open_dataset(tmp_path / "run" / "run.nc", engine="h5netcdf") as found:
        mean = found["mean"].values
    np.testing.assert_array_equal(arrays["smoothed_mean"][-1], arrays["filtered_mean"][-1])
    shrunk = arrays["filtered_cov"] - arrays["smoothed_cov"]
    assert (np.linalg.eigvalsh(shrunk) > -1e-12).all()
    assert len(told["distance"]) == mean.shape[2]
    # Later, from what was recorded.
    main(["collect", str(tmp_path / "run"), "--smooth"])
    assert "smoothed (smoothed.nc): nodes differ from it by" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("filter", ["ukf", "iekf", "srckf"])
def test_the_reference_is_nearer_to_the_truth_and_consistent(filter: str):
    """A linear plant, 6 runs: the error of later readings is known to be smaller."""
    figures = []
    for number in range(6):
        setup = prepare(scenario("oscillator", filter=filter, nodes=3, steps=60, run=number))
        trace = read_trace(setup, in_memory(setup))
        figures.append(smoothing_figures(setup, trace, smoothed_of(setup, trace), 10))
    better = [one.rmse < one.rmse_filtered for one in figures]
    assert sum(better) >= 5
    assert 0.6 < np.mean([one.anees for one in figures]) < 1.5


def test_without_truth_the_distance_of_the_nodes_is_told():
    setup = prepare(scenario("oscillator", nodes=3, steps=30))
    trace = read_trace(setup, in_memory(setup))
    blind = trace._replace(truth=np.full_like(trace.truth, np.nan))
    found = smoothed_of(setup, blind)
    figures = smoothing_figures(setup, blind, found, 5)
    assert np.isnan(figures.rmse) and np.isnan(figures.anees)
    known = smoothing_figures(setup, trace, found, 5)
    assert figures.distance == known.distance and min(figures.distance) > 0


def test_steps_in_which_the_filter_leaves_the_model_do_not_count_in_the_consistency():
    """A car that stands has no side slip that a single-track model could tell."""
    setup = prepare(scenario("vehicle-network", steps=30))
    trace = read_trace(setup, in_memory(setup))
    found = smoothed_of(setup, trace)
    standing = found.filtered.mean.copy()
    standing[20] = 0.0
    wrong = found.smoothed.mean.copy()
    wrong[20] += 1.0
    without = np.delete(np.arange(10, 30), 10)
    errors = (found.smoothed.mean - trace.truth)[without]
    nees = scored_nees(setup.scenario, errors, found.smoothed.cov[without])
    states = len(definition_of(setup.scenario).score.nees_states)
    away = Smoothed(Gaussian(standing, found.filtered.cov), Gaussian(wrong, found.smoothed.cov))
    figures = smoothing_figures(setup, trace, away, 10)
    assert figures.anees == pytest.approx(nees.mean() / states)
    counted = smoothing_figures(setup, trace, Smoothed(found.filtered, away.smoothed), 10)
    assert counted.anees > 10 * figures.anees


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--scenario oscillator --driver batched", "--smooth with --driver batched: it smooths"),
        ("--scenario liu2021-network --rule ellipsoid", "--smooth with --rule ellipsoid"),
        ("--scenario meng2025", "--smooth with --rule reception"),
    ],
)
def test_runs_without_such_a_filter_are_refused(
    options: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as ended:
        run(*options.split(), "--smooth", "--steps", "3", "--out", str(tmp_path / "run"))
    assert ended.value.code == 2 and says in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
