"""Runs on channels A and B with frames of their own: faults, figures, captures, all drivers."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from concord.bus.flexray.frame import decode
from concord.results.bus.bus_capture import capture
from concord.results.bus.bus_report import figures_of, lines
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.agree import agreement
from tests.experiments.command_support import concord, refused
from tests.experiments.support import scenario
from tests.laboratory.case import draw_case
from tests.laboratory.case_run import run_case
from tests.laboratory.script import is_harmless
from tests.nodes.changing import run, same_bits

pytestmark = pytest.mark.slow

APART = ["A", "B", "split", "mixed"]
CONTENDED = {"schedule": "hybrid", "occupancy": 0.5}


def network(channels: str, **options: object) -> Setup:
    asked = {"nodes": 8, "graph": "complete", "steps": 12, "cluster": "fitted-ab", **options}
    return prepare(scenario("oscillator", channels=channels, **asked))


def lost_of(setup: Setup, trace: Trace, letter: str) -> int:
    """Frames of shares on a channel alone, times the nodes that hear them."""
    bus, lost = build_bus(setup), 0
    for cycle, sizes in enumerate(trace.payload_bytes.reshape(-1, setup.scenario.nodes).tolist()):
        classes = trace.classes.reshape(-1, setup.scenario.nodes)[cycle].tolist()
        lost += sum(one.channel == letter for one in bus.transmissions(cycle, sizes, classes))
    return lost * (setup.scenario.nodes - 1)


@pytest.mark.zenoh
@pytest.mark.parametrize("schedule", [{}, CONTENDED], ids=["full", "contended"])
@pytest.mark.parametrize("channels", APART)
def test_all_drivers_agree(channels: str, schedule: dict[str, object]):
    found = agreement(network(channels, **schedule, nodes=5, steps=8, loss=0.1))
    assert found.near and found.differences == ()


@pytest.mark.parametrize("letter", ["A", "B"])
@pytest.mark.parametrize("channels", ["all", *APART])
def test_a_channel_that_fails_takes_the_shares_that_it_alone_carries(channels: str, letter: str):
    setup = network(channels, **CONTENDED)
    plain, struck = run(setup), run(setup, f"0 channel {letter} 1")
    lost = sum(one.get("lost", 0) for one in struck.counters)
    assert lost == lost_of(setup, struck, letter)
    assert (lost == 0) == (channels in ("all", {"A": "B", "B": "A"}[letter]))
    assert same_bits(plain, struck) == (lost == 0)


def test_a_channel_loses_single_frames_and_the_other_none():
    setup = network("split", **CONTENDED, steps=60)
    struck = run(setup, "0 channel B 0.3")
    lost = sum(one.get("lost", 0) for one in struck.counters) / 7
    frames = lost_of(setup, struck, "B") / 7
    assert lost == int(lost)
    assert abs(lost - 0.3 * frames) < 4 * np.sqrt(0.21 * frames)


def test_figures_name_the_load_of_each_channel():
    loads = {}
    for channels in ("all", *APART):
        setup = network(channels, **CONTENDED)
        figures = figures_of(runs_of_trace(setup, read_trace(setup, in_memory(setup))))
        assert figures is not None
        loads[channels] = figures.channel_loads
        said = "; A {:.1f} %, B {:.1f} %)".format(*(100 * one for one in loads[channels].values()))
        assert said in lines(figures)[0]
    assert loads["all"]["A"] == loads["all"]["B"] == loads["A"]["A"] == loads["B"]["B"]
    assert loads["A"]["B"] == loads["B"]["A"] == 0.0
    # Both carry the static frames of "mixed", and each its part of the dynamic ones.
    assert 0 < loads["split"]["B"] < loads["mixed"]["B"]


def test_the_capture_has_each_frame_on_its_channel_with_its_checksum():
    setup = network("split", changes=("0 channel B 1", "6 calm", "6 crc 4 1"))
    messages = list(in_memory(setup))
    trace = read_trace(setup, messages)
    found = capture(setup, trace, messages)
    assert found is not None
    half_us = 6 * setup.time_step_s * 1e6
    before = Counter(one.channel for one in found if one.time_us < half_us)
    after = Counter(one.channel for one in found if one.time_us >= half_us)
    cycles = 6 * setup.scenario.rounds
    # Three startup nodes are on both channels; of five others three are on A and two on B.
    assert before == {"A": 6 * cycles}
    assert after == {"A": 6 * cycles, "B": 5 * cycles}
    wrong = 0
    for one in found:
        try:
            decode(one.data, "A" if one.channel == "A" else "B")
        except ValueError as error:
            assert getattr(error, "reason", "") == "frame-crc"
            wrong += 1
    assert wrong == cycles
    # Two frames of one time and one ID are of two nodes.
    times = Counter((one.time_us, one.channel) for one in found)
    assert set(times.values()) == {1}


def test_what_cannot_be_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = (
        "run",
        "--scenario",
        "oscillator",
        "--nodes",
        4,
        "--channels",
        "split",
        "--out",
        tmp_path,
    )
    said = refused(concord(capsys, *words))
    assert "cluster 'fitted' has channel A alone; use --cluster fitted-ab" in said
    relay = ("--cluster", "fitted-ab", "--rule", "labelled", "--relay")
    assert "--relay: a share in a slot of one channel" in refused(concord(capsys, *words, *relay))
    table = ("--cluster", "audi", "--schedule", "written", "--slots", tmp_path / "own.toml")
    plan = ("flexray", "plan", "--scenario", "oscillator", "--nodes", 4, "--cluster", "audi")
    assert concord(capsys, *plan, "--out", tmp_path / "own.toml").code == 0
    assert "the slot table says which channel" in refused(concord(capsys, *words, *table))


def test_simulation_testing_knows_which_channel_carries_a_frame():
    fixed = {"cluster": "fitted-ab", "nodes": 5, "rule": "ci", "scenario": "oscillator",
             "control": "open", "wire": (), "channels": "split", "schedule": "hybrid",
             "occupancy": 0.6, "changes": ("1 channel A 0.5", "2 spoof 0 3 0.5")}  # fmt: skip
    case = draw_case(5, fixed)
    outcome = run_case(case)
    assert outcome.broken is None
    assert outcome.struck["channel"] and outcome.struck["spoof"]
    assert not is_harmless(case.scenario)
    drawn = Counter(
        getattr(draw_case(seed, {}).scenario.bus, "channels", "") for seed in range(1, 61)
    )
    assert {"all", "A", "split", "mixed"} <= {*drawn}
