"""Test `concord track` and the run behind it."""

import dataclasses
import json
import math
import re
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray

from concord.experiments.tracking.swarm_run import SwarmRun, run_swarm
from concord.experiments.tracking.track_log import TrackLog
from concord.filters.tracking import tracker
from concord.filters.tracking.scores import gospa
from concord.filters.tracking.tracks import no_tracks
from concord.scenarios.definitions.target_swarm import TargetSwarm
from tests.experiments.flexray_support import concord, refused
from tests.filters.tracking.position_sensor import tracks_at

SMALL = TargetSwarm(nodes=8, targets=4, steps=20, clutter=3)
SMALL_WORDS = ("--nodes", "8", "--targets", "4", "--steps", "20", "--clutter", "3")


@cache
def small_run() -> SwarmRun:
    """Return the run of the small swarm; many tests compare with it."""
    return run_swarm(SMALL)


def test_the_command_prints_what_the_run_gives(capsys: pytest.CaptureFixture[str]):
    printed = json.loads(concord(capsys, "track", *SMALL_WORDS, "--json").out)
    assert printed["runs"] == [msgspec.to_builtins(small_run())]
    assert printed["options"] == {**dataclasses.asdict(SMALL), "changes": []}
    table = concord(capsys, "track", *SMALL_WORDS).out
    assert f"{printed['runs'][0]['centre']['gospa_m']:.3g}" in table
    assert "8 nodes" in table and "GOSPA of the nodes over the centre's: 1" in table
    sent = f"The bus carries {printed['runs'][0]['frames']:.4g} frames, "
    assert f"{sent}{printed['runs'][0]['bytes']:.4g} bytes, a step; its cycles last " in table


def test_runs_are_independent_and_each_can_be_repeated(capsys: pytest.CaptureFixture[str]):
    steps = 8
    smaller = ("--nodes", "8", "--targets", "4", "--steps", str(steps), "--clutter", "3")
    words = ("track", *smaller, "--workers", "1", "--json")
    both = json.loads(concord(capsys, *words, "--runs", "2").out)["runs"]
    second = json.loads(concord(capsys, *words, "--run", "1").out)["runs"]
    assert both[1:] == second and both[0] != both[1]
    table = concord(capsys, *words[:-1], "--runs", "2", "--alone").out
    pairs = steps * SMALL.nodes * (SMALL.nodes - 1)
    assert "±" in table
    assert f"{pairs} pairs of nodes had equal records; the tracks of 0 differ." in table


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--detection", "1"), "--detection 1.0: must be above 0.001"),
        (("--clutter", "-1"), "--clutter -1.0: must be 0 to 200"),
        (("--targets", "100000"), "--targets 100000: must be 200 or fewer"),
        (("--loss", "1"), "--loss 1"),
        (("--bus", "flexry"), "flexry"),
        (("--occupancy", "0"), "--occupancy 0"),
        (("--cluster", "audy"), "unknown cluster 'audy'"),
        (("--bus", "plca", "--cluster", "audi"), "cluster"),
        (("--changes", "5 set rounds=2"), "--changes 5 set: tracks keep their rule and bus"),
        (("--changes", "5 kill 20"), "kill 20"),
        (("--payload-bytes", "20"), "raise --payload-bytes"),
        (("--merge-m", "-1"), "--merge-m -1.0: must be 0 m or more"),
        (("--targets", "0"), "--targets 0: must be 1 or more"),
        (("--runs", "0"), "--runs 0: must be 1 or more"),
        (("--association", "nearst"), "unknown association 'nearst': did you mean 'nearest'"),
        (("--nodes", "2", "--placement", "-1"), "--placement -1: must be 0 or more"),
    ],
)
def test_bad_input_is_refused(
    words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
):
    assert says in refused(concord(capsys, "track", *words))


def test_nodes_with_all_scans_are_as_good_as_the_centre_but_for_rounding():
    run = small_run()
    assert run.held == 1 and run.alike == 1
    assert run.nodes.gospa_m == pytest.approx(run.centre.gospa_m, rel=0.1)
    assert run.nodes.missed < 2 and run.nodes.false < 1


def test_a_tracker_that_keeps_the_order_of_arrival_is_found_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tracker, "in_order", lambda detections: detections)
    found = run_swarm(dataclasses.replace(SMALL, steps=8), alone=True).compared
    assert found is not None and found.different > 0


def test_few_rounds_and_losses_cost_the_nodes_but_not_the_centre():
    full = small_run()
    lossy = run_swarm(dataclasses.replace(SMALL, rounds=1, loss=0.5))
    assert lossy.centre == full.centre
    assert lossy.held < 0.9 and lossy.alike < 0.5
    assert lossy.nodes.gospa_m > 1.05 * lossy.centre.gospa_m


def test_nearest_neighbours_are_another_tracker():
    nearest = run_swarm(dataclasses.replace(SMALL, association="nearest"))
    assert nearest.centre != small_run().centre
    assert nearest.centre.missed < 2


def test_a_single_node_is_a_network():
    run = run_swarm(dataclasses.replace(SMALL, nodes=1, steps=5))
    assert run.alike == run.held == 1


def test_shortened_scans_are_told(capsys: pytest.CaptureFixture[str]):
    crowd = ("--nodes", "4", "--targets", "2", "--steps", "3")
    table = concord(capsys, "track", *crowd, "--clutter", "90", "--payload-bytes", "98").out
    assert "12 scans had more detections than a record holds" in table
    assert "scans had" not in concord(capsys, "track", *crowd).out


def test_the_file_of_tracks_gives_the_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ("track", *SMALL_WORDS, "--occupancy", "0.5", "--rounds", "1", "--json")
    printed = json.loads(concord(capsys, *words, "-o", str(tmp_path / "kept")).out)["runs"][0]
    swarm = TargetSwarm(**{**dataclasses.asdict(SMALL), "occupancy": 0.5, "rounds": 1})
    with xarray.open_dataset(tmp_path / "kept" / "tracks_0.nc", decode_times=False) as file:
        found = file.load()
    assert found.row_size.sum() == found.sizes["obs"] and (found.row_size > 0).all()
    assert len({*found.trajectory.values.tolist()}) == found.sizes["trajectory_number"]
    tracker = np.repeat(found.tracker.values, found.row_size.values)
    places = np.stack((found.x.values, found.y.values), axis=-1)
    truth = swarm.truth()
    for target in range(swarm.targets):
        (number,) = np.flatnonzero(
            (found.tracker.values == -2) & (found.identity.values[:, 0] == target)
        )
        end = int(found.row_size.values[: number + 1].sum())
        rows = slice(end - int(found.row_size.values[number]), end)
        there = np.isfinite(truth[:, target, 0])
        assert (np.diff(found.step.values[rows]) > 0).all()
        np.testing.assert_array_equal(found.step.values[rows], np.flatnonzero(there))
        np.testing.assert_array_equal(places[rows], truth[there, target, ::2])
    distances = np.array(
        [
            [
                gospa(
                    truth[step][np.isfinite(truth[step, :, 0])][:, ::2],
                    places[(tracker == number) & (found.step.values == step)],
                    50,
                ).distance
                for step in range(swarm.steps)
            ]
            for number in range(-1, swarm.nodes)
        ]
    )
    assert distances[0].mean() == pytest.approx(printed["centre"]["gospa_m"])
    assert distances[1:].mean() == pytest.approx(printed["nodes"]["gospa_m"])
    assert "exists" in refused(concord(capsys, *words, "-o", str(tmp_path / "kept")))


@pytest.mark.slow
def test_the_page_reads_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    page = (Path(__file__).parents[2] / "docs" / "targets.md").read_text()
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (command,) = re.findall(r"^concord (track .* -o swarm)$", page, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    concord(capsys, *command.split())
    exec(compile(program, "docs/targets.md", "exec"), {})
    told = capsys.readouterr().out.splitlines()
    assert told and all(re.fullmatch(r"3/\d+-\d+-\d+: steps \d+ to \d+", one) for one in told)


def test_scores_of_a_run_by_hand():
    log = TrackLog()
    truth = np.full((3, 2, 4), np.nan)
    truth[0, 0] = truth[1, 0] = truth[2, 0] = [0, 0, 0, 0]
    truth[1, 1] = truth[2, 1] = [200, 0, 0, 0]
    log.add(0, truth[0], no_tracks(4))  # missed
    log.add(1, truth[1], tracks_at(np.array([[3.0, 0, 4, 0], [500, 0, 0, 0]])))  # missed and false
    log.add(2, truth[2], tracks_at(np.array([[210.0, 0, 0, 0], [0, 0, 0, 0]])))  # switched
    scores = log.scores()
    assert scores.missed == pytest.approx(2 / 3) and scores.false == pytest.approx(1 / 3)
    assert scores.localisation_m == pytest.approx(math.sqrt((25 + 100) / 3))
    penalty = 50**2 / 2
    distances = [math.sqrt(penalty), math.sqrt(25 + 2 * penalty), 10]
    assert scores.gospa_m == pytest.approx(np.mean(distances))
    assert scores.ospa_m == pytest.approx(
        np.mean([50, math.sqrt((25 + 2500) / 2), math.sqrt(100 / 2)])
    )
    assert scores.cardinality_error == pytest.approx(1 / 3)
    assert scores.identity_switches == 1
    assert scores.steps_to_confirm == 1
