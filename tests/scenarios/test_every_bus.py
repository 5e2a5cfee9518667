"""Every bus of the table: its promises, every driver, its faults, its capture, sweep and design."""

import re
import struct
from math import ceil, floor
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from concord.bus.bus import Rejected
from concord.bus.pcap import write_pcap
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.panels.timeline import TimelineView
from concord.dashboard.theme import DARK
from concord.results.bus.bus_capture import capture
from concord.results.bus.bus_report import figures_of, lines
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare, share_bytes
from concord.scenarios.scenario import BusChoice
from concord.scenarios.scenario_options import scenario_of
from concord.scenarios.setup import Setup
from concord.scenarios.types.buses import TimedBus, UserBus
from concord.scenarios.types.option import name_of
from concord.scenarios.user.bus import broken_promises
from concord.studies.agree import agreement
from concord.studies.near_agreement import departures
from tests.dashboard.runs import frames_of
from tests.experiments.command_support import concord, dissect, needs_tshark, refused
from tests.experiments.support import scenario
from tests.experiments.test_bus_capture import packets

pytestmark = pytest.mark.slow

TYPES = [one for one in get_args(BusChoice) if one is not UserBus]
BUSES = [name_of(one) for one in TYPES]
TIMED = [name_of(one) for one in TYPES if issubclass(one, TimedBus)]
TURNS = {"schedule": "round-robin", "occupancy": 0.4}
CONTENDED = {"schedule": "hybrid", "occupancy": 0.6}


def network(bus: str, **options: object) -> Setup:
    return prepare(scenario("oscillator", **{"nodes": 5, "steps": 8, "bus": bus, **options}))


def test_the_table_has_more_than_one_bus_with_time():
    assert {"flexray", "plca", "can-fd"} <= set(TIMED)


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("schedule", [{}, TURNS, CONTENDED], ids=["full", "turns", "contended"])
def test_a_bus_keeps_the_promises_of_the_interface(bus: str, schedule: dict[str, object]):
    if bus == "ideal" and schedule == CONTENDED:
        pytest.skip("ideal has no contention")
    setup = network(bus, **schedule)
    assert list(broken_promises(build_bus(setup), share_bytes(setup))) == []


@pytest.mark.zenoh
@pytest.mark.parametrize("bus", TIMED)
@pytest.mark.parametrize("schedule", [{}, TURNS, CONTENDED], ids=["full", "turns", "contended"])
def test_all_drivers_agree(bus: str, schedule: dict[str, object]):
    found = agreement(network(bus, **schedule, loss=0.1))
    assert found.near and found.differences == ()


@pytest.mark.parametrize("bus", TIMED)
@pytest.mark.parametrize("rule", ["hcmci", "labelled"])
def test_rules_of_other_shares_agree_in_arrays(bus: str, rule: str):
    setup = network(bus, rule=rule, occupancy=0.6, loss=0.2, steps=20)
    assert not departures(setup, read_trace(setup, in_memory(setup)))


WORDS = ("2 corrupt 0.5", "2 crc 1 0.5", "2 null 2 0.5", "2 wrong-step 3 0.5 2", "2 babble 4 0.3",
         "2 duplicate 0.3", "2 replay 1 0.5 3", "2 spoof 0 1 0.5", "2 missing 3 0.5")  # fmt: skip


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("word", WORDS)
def test_faults_strike_frames_of_every_bus(bus: str, word: str):
    setup, healthy = network(bus, changes=(word,), steps=12), network(bus, steps=12)
    trace, whole = (read_trace(one, in_memory(one)) for one in (setup, healthy))
    assert not departures(setup, trace)
    counted = [node for node in trace.counters[-1] if any(key != "heard" for key in node)]
    silent = (trace.payload_bytes == 0).sum() > (whole.payload_bytes == 0).sum()
    assert counted or silent


@pytest.mark.parametrize("bus", [name for name in TIMED if name != "flexray"])
def test_faults_of_slots_and_channels_are_refused_in_a_sentence(bus: str):
    for word in ("2 drift 1 200", "2 channel B 0.5"):
        with pytest.raises(ValueError, match="choose") as refusal:
            network(bus, changes=(word,))
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("bus", TIMED)
def test_the_capture_has_each_frame_at_its_time_on_the_bus(bus: str):
    setup = network(bus, **CONTENDED)
    messages = list(in_memory(setup))
    trace = read_trace(setup, messages)
    found, planned = capture(setup, trace, messages), build_bus(setup)
    assert found is not None
    figures = figures_of(runs_of_trace(setup, trace))
    assert figures is not None and len(found) == figures.frames
    times = [one.time_us for one in found]
    assert times == sorted(times)
    for one in found:
        fragment = planned.receive(one.data)
        step, number = divmod(fragment.cycle, setup.scenario.rounds)
        first = floor(one.time_us / planned.cycle_us + 1e-6) - number
        # A step waits for the cycle in which its turn is due.
        earliest = ceil(step * setup.time_step_s * 1e6 / planned.cycle_us - 1e-6)
        period = planned.timebase.period
        assert earliest <= first < earliest + period
        assert (first - step * setup.scenario.rounds) % period == 0


@pytest.mark.parametrize("bus", TIMED)
def test_a_frame_with_a_wrong_checksum_is_marked_in_the_capture(bus: str):
    setup = network(bus, changes=("0 crc 1 1",))
    messages = list(in_memory(setup))
    found = capture(setup, read_trace(setup, messages), messages)
    planned = build_bus(setup)
    assert found is not None and planned.frame_format.link is not None
    wrong = []
    for one in found:
        try:
            planned.receive(one.data)
        except Rejected:
            wrong.append(one)
    assert len(wrong) == setup.scenario.rounds * setup.scenario.steps
    for one in wrong:
        right = one._replace(data=one.data[:-1] + bytes([one.data[-1] ^ 1]))
        body = planned.frame_format.link.body
        assert planned.receive(right.data) and body(right) != body(one)


@pytest.mark.parametrize("bus", TIMED)
def test_a_run_reports_its_bus(bus: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    said = concord(
        capsys, "run", "--scenario", "oscillator", "--nodes", 4, "--steps", 5, "--bus", bus,
        "--out", tmp_path / "run", "--json",
    )  # fmt: skip
    figures = said.json()["bus"]
    assert figures["frames"] == 4 * 5 * 3 == len(packets(tmp_path / "run" / "bus.pcap"))
    assert 0 < figures["bus_load_max"] <= 1
    assert 0 < figures["delay_us_max"] - figures["wait_us_max"] <= 3 * figures["cycle_us"]
    (kept,) = struct.unpack_from("<I", (tmp_path / "run" / "bus.pcap").read_bytes(), 20)
    assert kept == build_bus(network(bus)).frame_format.link.number  # pyright: ignore


@needs_tshark
@pytest.mark.parametrize(
    ("bus", "field"), [("plca", "eth.type"), ("can-fd", "can.id"), ("flexray", "flexray.fid")]
)
def test_wireshark_reads_the_capture(bus: str, field: str, tmp_path: Path):
    setup = network(bus)
    messages = list(in_memory(setup))
    found = capture(setup, read_trace(setup, messages), messages)
    assert found is not None
    link = build_bus(setup).frame_format.link
    assert link is not None
    write_pcap(tmp_path / "bus.pcap", found, link)
    rows = dissect(tmp_path / "bus.pcap", field, "_ws.malformed")
    assert len(rows) == len(found) and all(read and not malformed for read, malformed in rows)
    if bus == "plca":
        assert {int(read, 0) for read, _ in rows} == {0x88B5}


@pytest.mark.parametrize("bus", [name for name in TIMED if name != "flexray"])
def test_the_dashboard_draws_a_cycle_to_scale(bus: str):
    setup = network(bus, **CONTENDED)
    stage = set_stage(setup)
    frame = frames_of(stage, in_memory(setup))[-1]
    cycle = frame.cycles[-1]
    drawn = TimelineView(stage).draw(DARK, frame, [cycle], cycle, 0.0, None)
    boxes = re.findall(r'data-node="(\d+)".*?<rect x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', drawn)
    assert {int(node) for node, *_ in boxes} == {one.node for one in cycle.frames}
    assert stage.bus.segments()[0].name in drawn and "STATIC" not in drawn


@pytest.mark.parametrize("rule", ["ci", "hcmci", "labelled"])
@pytest.mark.parametrize(
    "bus, schedule",
    [("flexray", "dynamic"), ("can-fd", "dynamic"), ("plca", "round-robin")],
)
def test_an_occupancy_alone_takes_the_usual_schedule_of_the_bus(bus: str, schedule: str, rule: str):
    asked: dict = {"bus": bus, "rule": rule, "occupancy": 0.25}
    assert scenario_of("target-tracking", **asked).bus.schedule.name == schedule
    alone = scenario_of("target-tracking", bus=bus, rule=rule)
    assert (alone.bus.schedule.name, alone.bus.schedule.occupancy) == (schedule, 0.25)  # type: ignore[attr-defined]
    hybrid = scenario_of("target-tracking", **asked, schedule="hybrid")
    assert hybrid.bus.schedule.name == "hybrid"


@pytest.mark.parametrize("bus", TIMED)
def test_a_running_network_takes_another_occupancy(bus: str):
    setup = network(bus, changes=("4 set occupancy=0.4",), steps=12)
    trace = read_trace(setup, in_memory(setup))
    sent = (trace.payload_bytes > 0).sum(axis=-1)
    assert (sent[:4] == 5).all() and (sent[6:] == 2).all()
    assert not departures(setup, trace)


@pytest.mark.zenoh
@pytest.mark.parametrize("bus", [name for name in TIMED if name != "flexray"])
def test_it_sets_the_pace_of_real_time(bus: str, capsys: pytest.CaptureFixture[str]):
    said = concord(
        capsys, "run", "--scenario", "oscillator", "--nodes", 3, "--steps", 4, "--bus", bus,
        "--driver", "realtime", "--json",
    )  # fmt: skip
    assert said.code == 0, said


@pytest.mark.parametrize("bus", TIMED)
def test_no_share_of_a_run_exceeds_the_worst_access(bus: str):
    setup = network(bus, **CONTENDED)
    trace = read_trace(setup, in_memory(setup))
    figures, planned = figures_of(runs_of_trace(setup, trace)), build_bus(setup)
    assert figures is not None
    if np.isnan(planned.worst_access_us):
        assert figures.worst_access_us is None
        return
    assert figures.worst_access_us == planned.worst_access_us
    rounds_before_us = figures.wait_us_max + 2 * figures.cycle_us
    assert figures.delay_us_max - rounds_before_us <= planned.worst_access_us
    assert any(line.startswith("worst access") for line in lines(figures))


def test_one_sweep_covers_every_bus(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    said = concord(
        capsys, "sweep", "--scenario", "oscillator", "--nodes", 4, "--steps", 8, "--runs", 2,
        "--bus", ",".join(BUSES), "--occupancy", "0.5,1", "--schedule", "round-robin",
        "--out", tmp_path / "sweep",
    )  # fmt: skip
    assert said.code == 0, said
    for bus in BUSES:
        assert bus in said.out


def test_options_of_another_bus_are_refused(capsys: pytest.CaptureFixture[str]):
    sentence = refused(concord(capsys, "run", "--bus", "plca", "--cluster", "audi"))
    assert "--cluster audi: belongs to --bus flexray" in sentence
    sentence = refused(concord(capsys, "run", "--burst-frames", "2"))
    assert "--burst-frames 2: belongs to --bus plca" in sentence
    sentence = refused(concord(capsys, "run", "--bus", "plca", "--opportunity-bits", "0"))
    assert "--opportunity-bits 0: must be 1 to 255" in sentence


@pytest.mark.parametrize("bus", TIMED)
def test_cycles_that_exceed_a_step_are_refused(bus: str):
    with pytest.raises(ValueError, match="--stretch"):
        network(bus, rounds=500)
