"""The verdict of the page: words that follow from errors, beliefs and the band."""

import re
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.explain.help import HEADINGS, help_panel
from concord.dashboard.frames.expected import Expected, nothing_expected
from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.source import RecordedSource
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.frames.verdict import STEPS, health, verdict
from concord.dashboard.theme import DARK
from concord.dashboard.view import View
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from tests.dashboard.runs import run_of, setup_of

RUN = run_of("target-tracking", nodes=8, steps=45)
STATES = len(RUN.stage.score.nees_states)
UNKNOWN = nothing_expected(np.zeros(STEPS))


def scored(**scores: float) -> list[StepFrame]:
    """Return the newest frames with other scores."""
    return [frame._replace(scores=frame.scores._replace(**scores)) for frame in RUN.frames[-STEPS:]]


@pytest.mark.parametrize(
    ("times", "word"),
    [(1.0, "CONSISTENT"), (1.3, "CONSISTENT"), (3.0, "OVERCONFIDENT × 3"), (0.4, "CAUTIOUS")],
)
def test_without_a_band_the_size_of_errors_beside_beliefs_decides(times: float, word: str):
    # By definition the mean NEES of errors that are as large as believed is the number of states.
    judged = verdict(scored(nees=times**2 * STATES), UNKNOWN)
    assert judged.word == word
    assert judged.is_good == (times < 2)
    assert f"errors are {times:.2g} times what the nodes believe" in judged.reason


@pytest.mark.parametrize(
    ("level", "word", "usual"),
    [
        (STATES, "CONS", "believe, and"),
        (0.2 * STATES, "CONS", "believe, as in most other runs, and"),
        (9.0 * STATES, "OVER", "believe, more than in most other runs, and"),
        (0.05 * STATES, "CAUT", "believe, less than in most other runs, and"),
    ],
)
def test_a_band_decides_where_there_is_one(level: float, word: str, usual: str):
    band = Expected(np.full(STEPS, 0.1 * STATES), np.full(STEPS, 8.0 * STATES), np.full(STEPS, 1.0))
    judged = verdict(scored(nees=level), band)
    assert judged.word.startswith(word)
    assert usual in judged.reason
    # One step outside of it is chance.
    some = [*scored(nees=5.0)[:-1], scored(nees=99.0)[-1]]
    assert verdict(some, band).word == "CONSISTENT"


def test_estimates_that_differ_by_more_than_believed_disagree():
    believed = np.sqrt(np.mean([np.mean(frame.scores.width**2) for frame in RUN.frames[-STEPS:]]))
    assert verdict(scored(spread=0.9 * believed), UNKNOWN).word != "DISAGREEING"
    judged = verdict(scored(spread=4.0 * believed), UNKNOWN)
    assert (judged.word, judged.is_good) == ("DISAGREEING", False)
    assert "by 4 times" in judged.reason


def test_a_run_is_judged_once_its_steps_count_and_a_lie_is_found_out():
    run = run_of("target-tracking", nodes=8, steps=70, changes=("40 lie 3 5 4",))
    frames = run.frames

    def word(step: int) -> str:
        judged = frames[max(0, step + 1 - STEPS) : step + 1]
        return verdict(judged, nothing_expected(np.zeros(len(judged)))).word

    assert word(5) == "SETTLING"
    assert word(39) in ("CONSISTENT", "CAUTIOUS")
    assert re.fullmatch(r"OVERCONFIDENT × \S+", word(69))


def test_sets_that_do_not_hold_the_truth_are_overconfident():
    run = run_of("liu2021-network", steps=40, rule="ellipsoid")
    frame = run.frames[-1]
    wide = frame._replace(scores=frame.scores._replace(width=frame.scores.error + 1))
    assert verdict([wide], UNKNOWN).word == "CONSISTENT"
    narrow = frame._replace(scores=frame.scores._replace(width=frame.scores.error / 2))
    judged = verdict([narrow], UNKNOWN)
    assert (judged.word, judged.reason) == (
        "OVERCONFIDENT",
        f"{run.stage.nodes} sets do not hold the truth",
    )


def test_an_unknown_truth_gives_no_verdict():
    nothing = float("nan")
    assert verdict(scored(rmse=nothing, nees=nothing), UNKNOWN).word == "UNKNOWN"


def test_the_help_names_every_verdict_every_heading_and_every_mark():
    html = help_panel(View(theme=DARK), RUN.frames[-1])
    for word in ("CONSISTENT", "CAUTIOUS", "OVERCONFIDENT", "DISAGREEING", *HEADINGS, "NEES"):
        assert f"<b>{word}</b>" in html
    for word in ("truth", "blind", "stale", "rejected", "down", "sends", "cut"):
        assert word in html


def test_a_recording_tells_the_verdict_on_the_whole_run(tmp_path: Path):
    stage = set_stage(setup_of("oscillator", nodes=3, steps=4))
    file = tmp_path / "run.mcap"
    recorder = McapRecorder(file, stage.rounds, stage.setup.time_step_s, stage.bus.frame_format)
    drive(stage.setup, recorder, lambda _: None)
    recorder.close()
    source = RecordedSource(stage, file, "CHECK: too short; use more --steps")
    while source.pace().state == "LOADING":
        source.poll()
    assert source.pace().detail == "4 steps; the whole run: CHECK: too short; use more --steps"


def test_where_no_node_reads_anything_there_is_no_verdict_on_errors():
    blind = [frame._replace(seen=np.zeros_like(frame.seen)) for frame in RUN.frames[-STEPS:]]
    judged = verdict(blind, UNKNOWN)
    assert (judged.word, judged.is_good) == ("NO READINGS", None)
    one = blind[-1]._replace(seen=np.arange(len(blind[-1].seen)) == 2)
    assert verdict([*blind[:-1], one], UNKNOWN).word != "NO READINGS"


def test_health_counts_cut_links_and_dead_nodes_beside_the_verdict():
    frame = RUN.frames[-1]
    none = np.zeros_like(frame.lost)
    assert health(frame._replace(lost=none, cut=np.zeros_like(frame.cut))) == ""
    cut, alive = np.zeros_like(frame.cut), frame.alive.copy()
    cut[:2], alive[3] = True, False
    assert health(frame._replace(lost=none, cut=cut, alive=alive)) == "2 links cut, 1 node down"
