"""Automatic retransmission on CAN FD: frames that come at last, errors that count, and times."""

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest

from concord.features.other_buses.can_fd.can_fd_bus import CanFdBus
from concord.results.bus.bus_capture import capture
from concord.results.bus.bus_report import figures_of, lines
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.setup import Setup
from concord.studies.agree import agreement
from tests.experiments.support import scenario
from tests.laboratory.case import draw_case
from tests.laboratory.case_run import run_case
from tests.nodes.changing import run, same_bits
from tests.nodes.fault_networks import total

NODES = 4


def network(retransmissions: int, **options: object) -> Setup:
    asked = {"nodes": NODES, "graph": "complete", "steps": 20, "bus": "can-fd", **options}
    return prepare(scenario("oscillator", retransmissions=retransmissions, **asked))


def test_without_errors_nothing_changes_but_the_cycle():
    once, often = network(0), network(3)
    assert same_bits(run(once), run(often))
    buses = build_bus(once), build_bus(often)
    assert isinstance(buses[0], CanFdBus) and isinstance(buses[1], CanFdBus)
    # Four tries, three of which end in an error frame of 20 bits at 500 kbit/s.
    error_us = 3 * NODES * (20 / 0.5)
    assert buses[1].cycle_us == pytest.approx(4 * buses[0].cycle_us + error_us)
    assert buses[1].worst_access_us > 4 * buses[0].worst_access_us


@pytest.mark.parametrize("word", ["corrupt 0.2", "crc 2 0.5", "babble 1 0.4"])
def test_frames_that_fail_come_by_a_later_try(word: str):
    plain = run(network(16))
    struck = run(network(16), f"3 {word}")
    assert same_bits(plain, struck)
    assert total(struck)["error frame"] > 0
    assert total(struck)["rejected error-frame"] == 0


def test_a_frame_fails_for_all_receivers_or_for_none():
    struck = run(network(1), "0 crc 2 0.5")
    given_up = [one.get("rejected error-frame", 0) for one in struck.counters]
    assert given_up[2] == 0 and given_up[0] == given_up[1] == given_up[3] > 0
    # Of the two tries of such a frame both failed.
    assert struck.counters[2]["error frame"] >= 2 * given_up[0]


@pytest.mark.parametrize("retransmissions", [1, 3])
def test_tries_fail_as_often_as_they_are_struck(retransmissions: int):
    """The number of failed tries is geometric, up to the last try."""
    p, steps = 0.4, 100
    struck = run(network(retransmissions, steps=steps), f"0 crc 2 {p}")
    frames = struck.counters[2]["sent"]
    lost = struck.counters[0].get("rejected error-frame", 0)
    chance = p ** (retransmissions + 1)
    assert abs(lost - frames * chance) < 4 * np.sqrt(frames * chance)
    mean = sum(p**k for k in range(1, retransmissions + 2))
    assert abs(struck.counters[2]["error frame"] / frames - mean) < 4 / np.sqrt(frames)


def test_one_shot_spoils_a_frame_for_single_receivers():
    struck = run(network(0), "0 corrupt 0.5 2 1 one-way")
    assert "error frame" not in total(struck)
    assert struck.counters[1]["rejected frame-crc"] > 0
    assert "rejected frame-crc" not in struck.counters[0]


def test_capture_and_figures_have_each_error_at_its_time():
    setup = network(3, changes=("2 crc 1 0.6", "2 corrupt 0.1"))
    messages = list(in_memory(setup))
    trace, bus = read_trace(setup, messages), build_bus(setup)
    assert isinstance(bus, CanFdBus)
    errors = sum(one.get("error frame", 0) for one in trace.counters)
    found = capture(setup, trace, messages)
    assert found is not None
    kinds = Counter(one.collision for one in found)
    assert kinds[True] == errors > 0
    lost = sum(one.get("rejected error-frame", 0) for one in trace.counters) // (NODES - 1)
    assert kinds[False] == sum(one["sent"] for one in trace.counters) - lost
    # Frames and errors follow each other, and none reaches into the next cycle.
    size = int(trace.payload_bytes.max())
    frame_us = float(bus.frame_us(size))
    ends = [one.time_us + (bus.failed_us(size) if one.collision else frame_us) for one in found]
    gaps = [after.time_us - end for after, end in zip(found[1:], ends, strict=False)]
    assert min(gaps) > -1e-6
    cycles = np.array([one.time_us for one in found]) // bus.cycle_us
    last = (np.array(ends) - 1e-6) // bus.cycle_us
    assert np.array_equal(cycles, last)
    figures = figures_of(runs_of_trace(setup, trace))
    assert figures is not None and figures.error_frames == errors
    assert figures.error_us_per_step == pytest.approx(errors * bus.failed_us(size) / 20)
    assert any(line.startswith(f"errors: {errors} tries") for line in lines(figures))


def test_a_cycle_without_time_for_all_tries_is_refused():
    with pytest.raises(ValueError, match="on bus can-fd, but the plant is sampled every"):
        build_bus(network(16, nodes=20, steps=2))
        prepare(scenario("oscillator", bus="can-fd", nodes=40, retransmissions=16))


def test_the_time_of_errors_is_exact():
    bus = build_bus(network(1))
    assert isinstance(bus, CanFdBus)
    assert bus.failed_us(24) == float(bus.frame_us(24) + Fraction(23 * 1000, 500))


@pytest.mark.zenoh
@pytest.mark.slow
@pytest.mark.parametrize("schedule", [{}, {"schedule": "hybrid", "occupancy": 0.5}])
def test_all_drivers_agree(schedule: dict[str, object]):
    changes = ("2 corrupt 0.3", "4 crc 1 0.5", "5 babble 3 0.3")
    found = agreement(network(1, **schedule, steps=8, changes=changes))
    assert found.differences == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_simulation_testing_expects_the_same_frames(seed: int):
    fixed = {"bus": "can-fd", "retransmissions": 1, "nodes": 5, "rule": "ci", "control": "open",
             "scenario": "oscillator", "schedule": "hybrid", "occupancy": 0.6,
             "changes": ("1 corrupt 0.3", "2 crc 1 0.5", "3 babble 2 0.3")}  # fmt: skip
    outcome = run_case(draw_case(seed, fixed))
    assert outcome.broken is None
    assert outcome.struck["crc"] and outcome.struck["corrupt"] and outcome.struck["babble"]
