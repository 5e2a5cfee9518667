"""Test the figures that other runs give for a run, and that they slow no network beside them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from concord.dashboard.frames.source import assembled
from concord.dashboard.frames.stage import set_stage
from concord.experiments import other_runs
from concord.experiments.other_runs import OtherRuns, Question, expected, told_by
from concord.results.figures.figure_table import computed
from concord.results.figures.run_frame import frame_of
from concord.results.figures.run_view import RunView
from concord.runtime.drivers import in_memory
from concord.scenarios.preparation import setup_of_run
from concord.studies.monte_carlo.simulate import simulate
from concord.studies.priority import give_way
from tests.dashboard.runs import setup_of
from tests.processes import holds_within

ROOT = Path(__file__).resolve().parents[2]
SETUP = setup_of("oscillator", nodes=4, steps=25)
NICENESS = 15


def test_band_and_bound_are_those_of_the_runs():
    runs = 4
    nees = []
    for number in range(1000, 1000 + runs):
        setup = setup_of_run(SETUP, number)
        frames = assembled(set_stage(setup), in_memory(setup))
        nees.append([frame.scores.nees for frame in frames])
    told = told_by(SETUP, runs)
    low, high = np.quantile(nees, [0.025, 0.975], axis=0)
    np.testing.assert_allclose(np.array(told.nees_low, float), low, rtol=1e-8)
    np.testing.assert_allclose(np.array(told.nees_high, float), high, rtol=1e-8)
    numbers = range(1000, 1000 + runs)
    histories = simulate(SETUP, numbers)
    figures = computed(RunView(histories, frame_of(histories)))
    np.testing.assert_allclose(np.array(told.bound, float), figures["bound"])


def test_what_is_told_is_found_by_time_and_unknown_steps_are_the_last():
    told = told_by(SETUP, 3)
    at = expected(told, 0.1, np.array([0.0, 0.7, 99.0]))
    assert at.nees_high.tolist() == [told.nees_high[0], told.nees_high[7], told.nees_high[24]]


def test_the_process_tells_what_it_found(monkeypatch: pytest.MonkeyPatch):
    # On a fully loaded machine a process of low priority may wait for minutes.
    monkeypatch.setattr(other_runs, "give_way", lambda *_: None)
    others = OtherRuns(setup_of("oscillator", nodes=4, steps=10), sparing=False)
    times = np.array([0.0, 0.5])
    assert np.isnan(others(times).nees_low).all()
    assert holds_within(30.0, lambda: bool(np.isfinite(others(times).nees_low).all()))
    others.close()


def test_the_process_ends_with_whoever_asked():
    question = Question(setup_of("oscillator", nodes=8, steps=5000), sparing=True)
    process = subprocess.Popen(
        [sys.executable, "-m", "concord.experiments.other_runs"],
        cwd=ROOT,
        stdin=subprocess.PIPE,
    )
    assert process.stdin
    process.stdin.write(msgspec.json.encode(question) + b"\n")
    process.stdin.flush()
    time.sleep(0.5)
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(10.0) == 1


def test_who_gives_way_does_so_against_other_sessions_too():
    asleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    process = subprocess.Popen(asleep, start_new_session=True)
    try:
        give_way(NICENESS, process.pid)
        assert os.getpriority(os.PRIO_PROCESS, process.pid) == NICENESS
        session = Path(f"/proc/{process.pid}/autogroup")
        if not session.exists():
            pytest.skip("sessions have no priority on this system")
        assert session.read_text().split()[-1] == str(NICENESS)
    finally:
        process.kill()
        process.wait()


def test_a_session_that_is_shared_is_left_alone():
    asleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    process = subprocess.Popen(asleep)
    session = Path(f"/proc/{process.pid}/autogroup")
    try:
        before = session.read_text() if session.exists() else ""
        give_way(NICENESS, process.pid)
        assert (session.read_text() if session.exists() else "") == before
    finally:
        process.kill()
        process.wait()
