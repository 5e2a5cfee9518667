"""Test the scores of `target-swarm` in `concord run`, its run.nc and its sweeps."""

import json
import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray

from concord.features.several_targets.scanned_swarm import paths_of
from concord.features.several_targets.swarm_tracking import plant_of
from concord.features.several_targets.track_log import TrackLog
from concord.features.several_targets.tracking.scores import gospa
from concord.features.several_targets.tracking.tracks import no_tracks, report
from concord.features.several_targets.tracks_trace import TracksTrace
from concord.results.figures.summary import summarise
from concord.results.folder import read_description
from concord.results.records.runs_file import read_runs
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import prepare, setup_of_run
from concord.scenarios.setup import generator
from tests.experiments.command_support import concord
from tests.experiments.support import scenario
from tests.features.several_targets.tracking.position_sensor import settings, tracks_at
from tests.pages import blocks, commands

STEPS, NODES, TARGETS = 12, 6, 3
SMALL = ("--scenario", "target-swarm", "--nodes", f"{NODES}", "--targets", f"{TARGETS}",
         "--steps", f"{STEPS}", "--clutter", "3")  # fmt: skip


def figures(capsys: pytest.CaptureFixture[str], folder: Path, *words: str) -> dict:
    return json.loads(concord(capsys, "run", *SMALL, *words, "-o", str(folder), "--json").out)


def test_nodes_with_all_scans_are_as_good_as_the_centre_but_for_rounding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    full = figures(capsys, tmp_path / "full")
    tracking = full["tracking"]
    assert tracking["alike"] == 1 and tracking["differing"] == 0
    assert tracking["equal_records"] == STEPS * NODES * (NODES - 1) // 2
    assert tracking["network"]["gospa_m"] == pytest.approx(tracking["centre"]["gospa_m"], rel=0.1)
    assert full["worst_node_to_centralised"][0] == pytest.approx(1, abs=0.1)
    lossy = figures(capsys, tmp_path / "lossy", "--rounds", "1", "--loss", "0.5")
    # The centre does not depend on the network.
    assert lossy["tracking"]["centre"] == tracking["centre"]
    assert lossy["rmse_centralised"] == full["rmse_centralised"]
    assert lossy["tracking"]["alike"] < 0.5 and lossy["rmse"][0] > 1.05 * full["rmse"][0]
    nearest = figures(capsys, tmp_path / "nearest", "--association", "nearest")
    assert nearest["tracking"]["centre"] != tracking["centre"]


def test_the_file_of_a_run_gives_its_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ("--occupancy", "0.5", "--rounds", "1")
    printed = figures(capsys, tmp_path / "kept", *words)
    with xarray.open_dataset(tmp_path / "kept" / "run.nc", decode_times=False) as file:
        found = file.load()
    assert found.row_size.sum() == found.sizes["obs"] and (found.row_size > 0).all()
    assert len({*found.trajectory.values.tolist()}) == found.sizes["trajectory_number"]
    tracker = np.repeat(found.tracker.values, found.row_size.values)
    places = np.stack((found.track_x.values, found.track_y.values), axis=-1)
    asked = scenario("target-swarm", nodes=NODES, targets=TARGETS, steps=STEPS, clutter=3)
    draws = plant_of(asked).draw(lambda *who: generator(asked, *who), STEPS)
    truth = paths_of(np.concatenate((draws.initial[None], draws.process[:-1])))
    for target in range(TARGETS):
        (number,) = np.flatnonzero(
            (found.tracker.values == -2) & (found.identity.values[:, 0] == target)
        )
        end = int(found.row_size.values[: number + 1].sum())
        rows = slice(end - int(found.row_size.values[number]), end)
        there = np.isfinite(truth[:, target, 0])
        np.testing.assert_array_equal(found.track_step.values[rows], np.flatnonzero(there))
        np.testing.assert_array_equal(places[rows], truth[there, target, ::2])
    distances = np.array(
        [
            [
                gospa(
                    truth[step][np.isfinite(truth[step, :, 0])][:, ::2],
                    places[(tracker == number) & (found.track_step.values == step)],
                    50,
                ).distance
                for step in range(STEPS)
            ]
            for number in range(-1, NODES)
        ]
    )
    np.testing.assert_allclose(found.gospa.values[0], distances[1:].T)
    assert distances[0].mean() == pytest.approx(printed["tracking"]["centre"]["gospa_m"])
    assert np.sqrt((distances[0] ** 2).mean()) == pytest.approx(printed["rmse_centralised"][0])
    assert np.sqrt((distances[1:] ** 2).mean()) == pytest.approx(printed["rmse"][0])


def test_a_sweep_scores_tracks(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "s.nc"
    words = ("--occupancy", "1,0.25", "--rounds", "1", "--runs", "2", "--workers", "1")
    concord(capsys, "sweep", *SMALL, *words, "-o", str(out))
    with xarray.open_dataset(out) as file:
        found = file.load()
    assert found.rmse.attrs["units"] == "m"
    one = figures(capsys, tmp_path / "run", "--occupancy", "0.25", "--rounds", "1", "--run", "1")
    cell = found.sel(occupancy=0.25, run=1)
    assert float(cell.rmse) == pytest.approx(one["rmse"][0])
    assert float(cell.rmse_centralised) == pytest.approx(one["rmse_centralised"][0])
    for name, field in (("missed_targets", "missed"), ("steps_to_confirm", "steps_to_confirm")):
        assert float(cell[name]) == pytest.approx(one["tracking"]["network"][field])
        assert float(cell[f"{name}_centralised"]) == pytest.approx(one["tracking"]["centre"][field])


def test_the_page_reads_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    page = (Path(__file__).parents[3] / "docs" / "targets.md").read_text()
    monkeypatch.chdir(tmp_path)
    for command in commands(page):
        if not command.startswith("concord agree"):
            concord(capsys, *command.replace("--steps 20", "--steps 8").split()[1:])
    (program,) = blocks(page, "python")
    exec(compile(program, "docs/targets.md", "exec"), {})
    told = capsys.readouterr().out.splitlines()
    assert told and all(re.fullmatch(r"0/3/\d+-\d+-\d+: steps \d+ to \d+", one) for one in told)


@pytest.mark.zenoh
def test_the_drivers_agree_as_the_page_says(capsys: pytest.CaptureFixture[str]):
    page = (Path(__file__).parents[3] / "docs" / "targets.md").read_text()
    found = [one for one in commands(page) if one.startswith("concord agree")]
    assert {"track-ci" in command for command in found} == {False, True}
    for command in found:
        assert "in-process = processes, bit for bit" in concord(capsys, *command.split()[1:]).out


def test_the_report_of_many_runs_scores_the_tracks_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out, words = tmp_path / "many", ("--changes", "9 kill 2", "--rounds", "2", "--run", "3")
    many = ("--driver", "batched", "--runs", "2", "--json", "-o", str(out))
    printed = json.loads(concord(capsys, "run", *SMALL, *words, *many).out)
    setup = read_description(out).setup
    found, cost = read_runs(out / "run.nc", setup)
    again = summarise(found, cost)
    assert again.value("rmse") == pytest.approx(printed["rmse"][0], rel=1e-12)
    assert again.value("rmse_centralised") == pytest.approx(
        printed["rmse_centralised"][0], rel=1e-12
    )
    for run, tracks in zip((3, 4), found.extras, strict=True):
        expected = read_trace(one := setup_of_run(setup, run), in_memory(one)).extra
        assert isinstance(tracks, TracksTrace) and isinstance(expected, TracksTrace)
        assert len(expected.logs[2].steps) == 9
        np.testing.assert_array_equal(tracks.paths, expected.paths)
        for log, other in zip(tracks.logs, expected.logs, strict=True):
            assert log.steps == other.steps
            found_scores, scores = map(msgspec.structs.asdict, (log.scores(), other.scores()))
            assert found_scores == pytest.approx(scores, nan_ok=True)


def test_a_single_node_is_a_network():
    setup = prepare(scenario("target-swarm", nodes=1, steps=5))
    trace = read_trace(setup, in_memory(setup))
    assert trace.extra is not None and trace.steps == 5


def test_scores_of_a_run_by_hand():
    log = TrackLog()
    truth = np.full((3, 2, 4), np.nan)
    truth[0, 0] = truth[1, 0] = truth[2, 0] = [0, 0, 0, 0]
    truth[1, 1] = truth[2, 1] = [200, 0, 0, 0]
    alone = settings().models.moments
    far, both = np.array([[3.0, 0, 4, 0], [500, 0, 0, 0]]), np.array([[210.0, 0, 0, 0], [0] * 4])
    log.add(0, truth[0], report(no_tracks(4), alone))  # missed
    log.add(1, truth[1], report(tracks_at(far), alone))  # missed and false
    log.add(2, truth[2], report(tracks_at(both), alone))  # switched
    scores = log.scores()
    assert scores.missed == pytest.approx(2 / 3) and scores.false == pytest.approx(1 / 3)
    assert scores.localisation_m == pytest.approx(math.sqrt((25 + 100) / 3))
    penalty = 50**2 / 2
    distances = [math.sqrt(penalty), math.sqrt(25 + 2 * penalty), 10]
    assert scores.gospa_m == pytest.approx(np.mean(distances))
    assert log.distances(4)[:3] == pytest.approx(distances) and np.isnan(log.distances(4)[3])
    assert scores.ospa_m == pytest.approx(
        np.mean([50, math.sqrt((25 + 2500) / 2), math.sqrt(100 / 2)])
    )
    assert scores.cardinality_error == pytest.approx(1 / 3)
    assert scores.identity_switches == 1
    assert scores.steps_to_confirm == 1
