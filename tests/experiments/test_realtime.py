"""Test a network in real time: its timetable, its faults, and its answers to commands."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from concord.nodes.changes import Calm, Cut, Fault
from concord.nodes.commands import Answer, in_words
from concord.nodes.messages import Grant, Timing, decode, encode, topic
from concord.nodes.tempo import Tempo
from concord.results.figures.timing_figures import TimingFigures, figures_of, lines
from concord.runtime.drivers import in_this_process
from concord.runtime.network.control_client import Client
from concord.runtime.processes.job import Happened
from concord.runtime.processes.launcher import run_processes
from concord.runtime.recording import read_recording
from concord.scenarios.setup import Setup
from concord.scenarios.tempo import tempo_of
from concord.studies.agree import first_difference
from tests.experiments.support import small, trace_of

# In short cycles a busy machine makes most nodes late; these last 100 ms, steps 300 ms.
SLOWER, STEP_S = 3, 0.3


def play(
    setup: Setup,
    folder: Path,
    on_event: Callable[[Happened], None] = lambda happened: None,
    slower: float = 1.0,
) -> TimingFigures:
    """Run a setup in real time, with cycles `slower` times as long as by default."""
    tempo = tempo_of(setup, slower * tempo_of(setup, None).stretch)
    recording = folder / "run.mcap"
    run_processes(setup, "realtime", recording, None, on_event, tempo)
    trace = trace_of(setup, recording)
    return figures_of(tempo, read_recording(recording), trace.counters, trace.estimate_age_s)


@pytest.mark.zenoh
def test_a_short_run_keeps_its_timetable(tmp_path: Path):
    setup = small(steps=10)
    figures = play(setup, tmp_path, slower=SLOWER)
    assert figures.step_ms == pytest.approx(1e3 * STEP_S)
    assert figures.cycle_ms == pytest.approx(100)
    assert figures.cycles == 4 * 10 * 3
    # The estimate follows the deadline of the last round, however fast the nodes are.
    assert figures.delay.p50_ms > 3 * figures.cycle_ms
    assert 0 < figures.cycle_jitter.p50_ms <= figures.cycle_jitter.p99_ms
    assert figures.deadline_misses == figures.incomplete + figures.overrun < figures.cycles / 2
    trace = trace_of(setup, tmp_path / "run.mcap")
    assert trace.steps == 10
    if sum(c.get("missed", 0) for c in trace.counters) == 0:
        # A run without missed frames has the results of lockstep.
        in_this_process(setup, "reference", tmp_path / "reference.mcap", None, lambda step: None)
        reference = trace_of(setup, tmp_path / "reference.mcap")
        assert first_difference(reference, trace, "realtime") is None


@pytest.mark.zenoh
def test_faults_strike_the_same_frames_as_in_lockstep_and_cost_no_time(tmp_path: Path):
    lines = (
        "2 corrupt 0.3", "2 duplicate 0.5", "3 missing 1 0.5", "3 hang 3 2", "4 cut 0 1",
        "4 outlier 2 0.5 20", "6 lie 2 3 4", "6 replay 0 0.5 2", "8 calm",
    )  # fmt: skip
    setup = small(steps=11, changes=lines)
    figures = play(setup, tmp_path)
    recorded = list(read_recording(tmp_path / "run.mcap"))
    events = [decode(name, data) for name, data in recorded if name == "event"]
    ours = [one.step for one in events if isinstance(one.change, Fault | Cut | Calm)]
    assert ours == [2, 2, 3, 3, 4, 4, 4, 6, 6, 8]
    trace = trace_of(setup, tmp_path / "run.mcap")
    in_this_process(setup, "reference", tmp_path / "reference.mcap", None, lambda step: None)
    reference = trace_of(setup, tmp_path / "reference.mcap")
    known = ~np.isnan(trace.readings)
    np.testing.assert_array_equal(trace.readings[known], reference.readings[known])
    if figures.deadline_misses == 0:
        assert first_difference(reference, trace, "realtime") is None
        assert trace.counters == reference.counters


# How each command is answered; None where it is obeyed.
ANSWERS = {
    "pause": "pause: in real time the clock says when a step begins; use --driver processes",
    "resume": "resume: in real time",
    "step 2": "step: in real time",
    "speed 5": "speed: in real time",
    "set rule=hcmci": "set: in real time nobody waits",
    "set rounds=2": "give them before the run, or use --driver processes",
    "kill 9": "there are nodes 0 to 3",
    "restart 1": "restart 1: the node is not out",
    "crc 1 1": None,
    "cut 0 1": None,
    "heal": None,
    "loss 0.1": None,
    "calm": None,
}


@pytest.mark.zenoh
def test_every_command_is_obeyed_or_refused_with_reason_and_cure(tmp_path: Path):
    answers: dict[str, Answer] = {}

    def ask(happened: Happened) -> None:
        if happened.what == "started":
            connect.extend(happened.connect)
        if happened.what == "step" and not answers:
            client = Client(connect, "realtime")
            for words in ANSWERS:
                if words == "cut 0 1":
                    # A step must begin with a fault before `calm` ends it.
                    begun = client.state()["released"]
                    while client.state()["released"] <= begun + 1:
                        time.sleep(0.02)
                answers[words] = client.command(in_words(words.split()))
            client.close()

    connect: list[str] = []
    setup = small(steps=30)
    figures = play(setup, tmp_path, ask)
    for words, reason in ANSWERS.items():
        assert answers[words].accepted == (reason is None), words
        assert (reason or "") in answers[words].detail, answers[words]
    counters = trace_of(setup, tmp_path / "run.mcap").counters
    assert sum(one.get("rejected frame-crc", 0) for one in counters) > 0
    # Nothing of it moved the clock: readings come when they are taken.
    assert figures.heartbeat.p50_ms > 0


@pytest.mark.parametrize(
    ("changed", "stretch", "named"),
    [
        ({"bus": "ideal"}, None, "--bus ideal: a bus without time sets no pace"),
        ({"changes": ("3 kill 1", "5 set rounds=2")}, None, "set at step 5 waits until all"),
        ({}, 0.5, "--cycle-stretch 0.5: must be at least 1"),
    ],
)
def test_what_cannot_be_timed_is_refused(changed: dict, stretch: float | None, named: str):
    with pytest.raises(ValueError, match=named):
        tempo_of(small(**changed), stretch)


def test_a_loop_through_an_estimate_is_refused():
    setup = small("cruise-control", control="0")
    with pytest.raises(ValueError, match="--control 0"):
        tempo_of(setup, None)


def test_cycles_last_as_long_as_processes_can_hold():
    setup = small(steps=2)
    tempo = tempo_of(setup, None)
    assert tempo.cycle_s == pytest.approx(0.1 / 3)
    assert tempo.step_s == pytest.approx(0.1)
    assert tempo_of(small("target-tracking", steps=2), None).cycle_s == pytest.approx(0.1)
    # Where cycles do not fit between sampling instants, these follow when cycles are over.
    slow = tempo_of(setup, 6 * tempo.stretch)
    assert slow.cycle_s == pytest.approx(0.2)
    assert slow.step_s == pytest.approx(3 * 0.2)
    assert slow.group_ends_s(2, 2, 0, 1) == pytest.approx(slow.step_begins_s(3))
    assert slow.group_ends_s(0, 1, 0, 4) == pytest.approx(0.25)


def test_figures_count_what_was_said():
    said = [
        Timing(0, 0, 0.001, [0.001, 0.002, 0.003], 1, 0),
        Timing(1, 0, 0.050, [0.050, 0.030, 0.010], 0, 2),
    ]
    granted = [Grant(0, [1], 0), Grant(1, [1], 0, [0, 2])]
    messages = [(topic(one), encode(one)) for one in (*said, *granted)]
    figures = figures_of(
        Tempo(10.0, 0.02, 0.1),
        messages,
        [{"late": 2, "heard": 8}, {"heard": 10}],
        np.array([[0.061, 0.071]]),
    )
    assert (figures.cycles, figures.deadline_misses, figures.late_shares) == (6, 3, 2)
    assert figures.late_bids == 2
    assert figures.late_percent == 100 * 2 / 20
    assert figures.cycle_jitter.largest_ms == pytest.approx(50)
    assert figures.delay.p50_ms == pytest.approx(66)
    assert figures.delay_limit_ms == pytest.approx(2600)
    assert "deadline misses 3 of 6 cycles" in lines(figures)[1]
