"""Recordings that were cut off, and recordings that are still written."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from concord.dashboard.frames.frame import StepFrame
from concord.dashboard.frames.source import RecordedSource
from concord.dashboard.frames.stage import set_stage
from concord.scenarios.setup import Setup
from tests.dashboard.browser_page import recorded

NODES, STEPS = 4, 30


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Setup, Path]:
    return recorded(tmp_path_factory.mktemp("whole"), nodes=NODES, steps=STEPS, seed=3)


def all_of(source: RecordedSource) -> list[StepFrame]:
    frames: list[StepFrame] = []
    while new := source.poll():
        frames += new
    return frames


def old(file: Path) -> Path:
    """Return a file that was written to long ago."""
    long_ago_s = time.time() - 3600
    os.utime(file, (long_ago_s, long_ago_s))
    return file


@pytest.mark.parametrize("share", [0.3, 0.45, 0.6, 0.71, 0.88])
def test_a_truncated_recording_ends_at_its_last_whole_step(
    run: tuple[Setup, Path], tmp_path: Path, share: float
):
    setup, whole = run
    file = tmp_path / "run.mcap"
    data = whole.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    source = RecordedSource(set_stage(setup), old(file))
    frames = all_of(source)
    wanted = all_of(RecordedSource(set_stage(setup), whole))
    assert 0 < len(frames) < len(wanted)
    for frame, one in zip(frames, wanted, strict=False):
        assert frame.alive.all()
        assert frame.scores.rmse == one.scores.rmse
        assert np.isfinite(frame.scores.rmse)
    pace = source.pace()
    assert pace.state == "RECORDED"
    assert f"the recording ends within step {len(frames)}" in pace.detail


def test_a_whole_recording_has_all_steps_and_says_no_more(run: tuple[Setup, Path]):
    source = RecordedSource(set_stage(run[0]), run[1])
    assert len(all_of(source)) == STEPS
    source.poll()
    assert source.pace().detail == f"{STEPS} steps"


def test_a_recording_that_grows_is_followed_to_its_end(
    run: tuple[Setup, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("concord.dashboard.frames.source._LOOK_S", 0.0)
    setup, whole = run
    file = tmp_path / "run.mcap"
    data = whole.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    source = RecordedSource(set_stage(setup), file)
    first = all_of(source)
    assert 0 < len(first) < STEPS
    assert source.pace().state == "LOADING"
    assert "the recording grows" in source.pace().detail
    shutil.copyfile(whole, file)
    rest = all_of(source)
    assert [frame.step for frame in first + rest] == list(range(STEPS))
    assert all(frame.alive.all() for frame in rest)
    source.poll()
    assert source.pace().state == "RECORDED"
