"""Times, load and delay of the bus: against sums by hand, recordings, and Wireshark."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from concord.bus.arbitration import ARBITERS, ONE_CLASS
from concord.bus.flexray.cluster import Cluster
from concord.bus.flexray.flexray_bus import FlexRayBus
from concord.bus.flexray.share_frames import read_frame
from concord.bus.flexray.slot_table import allocate
from concord.bus.schedule import Schedule
from concord.bus.timebase import Pace
from concord.features.flexray_tools.commands.rehearsal import rehearse
from concord.results.bus.bus_report import bus_figures, figures_of, lines, longest_waits
from concord.results.bus.bus_times import bus_times, timetable
from concord.results.bus.sent_shares import SentShares
from concord.results.records.runs import runs_of_trace
from concord.results.records.trace import read_trace
from concord.runtime.drivers import in_memory
from concord.scenarios.build import build_bus
from concord.scenarios.preparation import prepare
from concord.scenarios.scenario_options import scenario_with_known
from concord.scenarios.setup import Setup

# --- by hand -----------------------------------------------------------------------------------

SMALL = Cluster(
    name="small",
    cycle_us=400.0,
    macroticks_per_cycle=400,
    macrotick_us=1.0,
    microticks_per_cycle=16000,
    static_slots=2,
    static_slot_macroticks=60,
    action_point_macroticks=5,
    static_payload_words=10,
    minislots=20,
    minislot_macroticks=10,
    minislot_action_point_macroticks=5,
    dynamic_payload_words=10,
    latest_transmission_minislot=17,
    network_idle_time_macroticks=80,
)
# 9 bits TSS, FSS, ten bits for each of 5 + 20 + 3 bytes, two bits FES: 292 bits at 10 Mbit/s.
FRAME_US = 29.2
SENDERS = [(0, 2), (1, 2), (0, 2), (1, 3)]
ASKERS = [(2, 3), (2, 3), (2, 3), (3,)]


def small_plan() -> FlexRayBus:
    """Nodes 0 and 1 share static slot 1, nodes 2 and 3 contend for one dynamic frame a cycle."""
    schedule = Schedule(4, ((0,), (1,)), ((2, 3),), (1,))
    table = allocate(schedule, SMALL, (20,), (20,))
    return FlexRayBus(schedule, SMALL, table, ARBITERS["wtod"], ONE_CLASS)


def marked(rows: list[tuple[int, ...]]) -> np.ndarray:
    """(2 steps, 2 rounds, 4 nodes)."""
    return np.array([[node in row for node in range(4)] for row in rows]).reshape(2, 2, 4)


def in_one_class(payload_bytes: np.ndarray) -> SentShares:
    """Return shares of nodes with one frame ID each."""
    return SentShares(payload_bytes, np.zeros_like(payload_bytes))


def sizes(rows: list[tuple[int, ...]]) -> np.ndarray:
    """Return 20 bytes for each sender."""
    return 20 * marked(rows)


def test_a_small_bus_by_hand():
    figures = bus_figures(
        small_plan(),
        in_one_class(sizes(SENDERS)),
        marked(ASKERS),
        np.array([[0, 0, 1], [3, 0, -1]]),
    )
    assert (figures.cluster, figures.cycle_us) == ("small", 400.0)
    assert figures.frames == 8
    assert (figures.frames_per_cycle_mean, figures.frames_per_cycle_max) == (2.0, 2)
    assert figures.bus_load == pytest.approx(2 * FRAME_US / 400)
    assert figures.bus_load_max == pytest.approx(2 * FRAME_US / 400)
    # Eight frames of 20 bytes and 8 around them in two steps.
    assert figures.bytes_per_step == 4 * 28
    assert figures.wire_us_per_step == pytest.approx(4 * FRAME_US)
    # The dynamic segment begins after two slots of 60 us; node 2 sends in its first minislot, and
    # node 3 one minislot of 10 us later; the action point is 5 us into the minislot.
    last_us = (400 + 125 + FRAME_US, 400 + 135 + FRAME_US)
    assert figures.delay_us == pytest.approx(sum(last_us) / 2)
    assert figures.delay_us_max == pytest.approx(last_us[1])
    assert (figures.contenders, figures.starved) == (2, [])
    assert (figures.longest_wait_cycles, figures.longest_wait_node) == (3, 3)
    assert (figures.share_ages, figures.never_heard) == ([3, 1, 0, 1], 1)


def test_a_bus_that_goes_on_between_the_steps_by_hand():
    """Steps of 2600 us on cycles of 400 us; turns repeat after two cycles, and so do two rounds."""
    bus = small_plan().paced(Pace(2600.0, 2))
    ages = np.array([[0, 1, -1], [0, 2, 3]])
    figures = bus_figures(bus, in_one_class(sizes(SENDERS)), marked(ASKERS), ages)
    # Step 1 is measured in cycle 6, has its turn from cycle 8 on, and ends with cycle 9.
    assert [bus.timebase.bus_cycle(cycle) for cycle in range(4)] == [0, 1, 8, 9]
    assert (figures.cycles, figures.cycles_all) == (4, 13)
    assert figures.bus_load == pytest.approx(2 * FRAME_US / 400)
    assert figures.bus_load_all == pytest.approx(8 * FRAME_US / 5200)
    assert figures.frames_per_cycle_all == pytest.approx(8 / 13)
    assert figures.wait_us_max == pytest.approx(8 * 400 - 2600)
    last_us = (400 + 125 + FRAME_US, 600 + 400 + 135 + FRAME_US)
    assert figures.delay_us == pytest.approx(sum(last_us) / 2)
    assert figures.delay_us_max == pytest.approx(last_us[1])
    # Of the ages 0, 1; 0, 2, 3: cycles 1, 0; 9, 1 and 0.
    assert (figures.share_age_median_all, figures.share_age_max_all) == (1.0, 9)
    assert (figures.longest_wait_cycles, figures.longest_wait_all) == (3, 9)
    times = bus_times(bus, in_one_class(sizes(SENDERS)))
    np.testing.assert_array_equal(times.bus_cycle, [[0, 1], [8, 9]])
    np.testing.assert_allclose(times.delay_us, last_us)


def test_times_of_a_small_bus_by_hand():
    times = bus_times(small_plan(), in_one_class(sizes(SENDERS)))
    nan = np.nan
    begins = [[[5, nan, 125, nan], [nan, 5, 125, nan]], [[5, nan, 125, nan], [nan, 5, nan, 135]]]
    np.testing.assert_allclose(times.share_start_us, begins)
    np.testing.assert_allclose(times.share_end_us, np.array(begins) + FRAME_US)
    np.testing.assert_allclose(times.load, np.full((2, 2), 2 * FRAME_US / 400))
    np.testing.assert_allclose(times.delay_us, [400 + 125 + FRAME_US, 400 + 135 + FRAME_US])


def test_shares_take_as_much_of_the_bus_as_they_have_bytes():
    schedule = Schedule(4, ((0,),), ((2, 3),), (2,))
    table = allocate(schedule, SMALL, (20, 20), (20,))
    plan = FlexRayBus(schedule, SMALL, table, ARBITERS["wtod"], ONE_CLASS)
    # Static frames of 20 bytes: one, then two of them. Dynamic frames of 8 and 20 bytes.
    sizes = np.array([[20, 0, 8, 20], [40, 0, 20, 0]])
    first, second = timetable(plan, in_one_class(sizes))
    assert [(f.node, f.frame_id, f.payload_bytes) for f in first] == [
        (0, 1, 20), (2, 3, 8), (3, 4, 20),
    ]  # fmt: skip
    # 9 + 1 + 10 (5 + 8 + 3) + 2 bits are 17.2 us: two minislots of 10 us, and one of silence.
    assert first[1].end_us == pytest.approx(125 + 17.2)
    assert first[2].start_us == pytest.approx(125 + 30)
    assert [(f.node, f.frame_id, f.payload_bytes) for f in second] == [
        (0, 1, 20), (0, 2, 20), (2, 3, 20),
    ]  # fmt: skip


def test_who_never_wins_starves_and_is_named():
    sent = marked([(0, 2), (1, 2), (0, 2), (1, 2)])
    asked = marked([(2, 3)] * 4)
    figures = bus_figures(small_plan(), in_one_class(20 * sent), asked, np.zeros((2, 0), dtype=int))
    assert figures.starved == [3]
    assert (figures.longest_wait_cycles, figures.longest_wait_node) == (4, 3)
    text = "\n".join(lines(figures))
    assert "longest wait 4 cycles (node 3)" in text and "starved (never sent): nodes 3" in text


def test_silence_on_the_bus_is_no_load():
    nobody = marked([()] * 4)
    figures = bus_figures(small_plan(), in_one_class(0 * nobody), nobody, np.full((2, 1), -1))
    assert (figures.frames, figures.bus_load_max, figures.contenders) == (0, 0.0, 0)
    assert figures.longest_wait_node is None
    assert figures.delay_us_max == pytest.approx(400.0)


def test_waits_are_counted_over_contended_cycles_in_a_row():
    asked = np.array([[1, 1], [0, 0], [1, 0], [1, 1], [1, 1]], dtype=bool)
    sent = np.array([[0, 1], [0, 0], [0, 0], [1, 0], [0, 1]], dtype=bool)
    # Node 0 waits in cycles 0 and 2 (nobody asks in 1), then in 4; node 1 once, in cycle 3.
    waits, over_all = longest_waits(asked, sent, np.array([0, 1, 200, 201, 400]))
    assert waits.tolist() == [2, 1]
    # Between cycles 0 and 2 of the rounds, 199 cycles of the bus carry no round.
    assert over_all.tolist() == [201, 1]


# --- any run -----------------------------------------------------------------------------------


choices = st.fixed_dictionaries(
    {
        "nodes": st.integers(3, 9),
        "rounds": st.integers(1, 3),
        "cluster": st.sampled_from(["fitted", "audi", "bosch", "flexray-adapter", "demo"]),
        "schedule": st.sampled_from(["round-robin", "hybrid", "dynamic"]),
        "arbiter": st.sampled_from(["urgency", "wtod", "minislot", "round-robin"]),
        "occupancy": st.floats(0.05, 1.0),
        "number": st.sampled_from(["float64", "float32"]),
        "trigger": st.sampled_from([0.0, 0.5]),
    }
)


def prepared(options: dict) -> Setup:
    options = {"scenario": "oscillator", "graph": "ring", "steps": 2, **options}
    try:
        return prepare(scenario_with_known(**options)[0])
    except ValueError:
        assume(False)
        raise


def flexray_bus(setup: Setup) -> FlexRayBus:
    """The bus of a setup that has one of FlexRay."""
    bus = build_bus(setup)
    assert isinstance(bus, FlexRayBus)
    return bus


def assert_orderly(plan: FlexRayBus, sent: SentShares) -> None:
    """One frame at a time, each in its segment, none begun after pLatestTx."""
    cluster = plan.cluster
    static_us = cluster.static_slots * cluster.static_slot_us
    latest_us = cluster.minislot_start_us(cluster.latest_transmission_minislot + 1)
    segment_us = cluster.minislot_start_us(cluster.minislots + 1)
    for cycle in timetable(plan, sent):
        for earlier, later in pairwise(cycle):
            assert earlier.end_us < later.start_us
            assert earlier.frame_id < later.frame_id
        for frame in cycle:
            if frame.segment == "static":
                assert frame.end_us < static_us
            else:
                assert static_us < frame.start_us < latest_us
                assert frame.end_us < segment_us


@settings(max_examples=15)
@given(choices)
def test_no_two_frames_of_a_run_overlap_and_all_were_recorded(options: dict):
    setup = prepared(options)
    messages = in_memory(setup)
    trace, plan = read_trace(setup, messages), flexray_bus(setup)
    assert_orderly(plan, trace.sent)
    planned = {
        (number, frame.node, frame.frame_id, frame.payload_bytes)
        for number, cycle in enumerate(timetable(plan, trace.sent))
        for frame in cycle
    }
    shares = [(int(topic[6:]), data) for topic, data in messages if topic.startswith("share/")]
    # A frame is 5 bytes of header, the payload, 3 bytes of checksum.
    recorded = {
        (read_frame(data).cycle, node, read_frame(data).frame_id, len(data) - 8)
        for node, data in shares
    }
    assert planned == recorded and len(recorded) == len(shares)


@settings(max_examples=60)
@given(choices, st.integers(10, 40))
def test_no_two_frames_of_a_larger_network_overlap(options: dict, nodes: int):
    setup = prepared({**options, "nodes": nodes})
    plan = flexray_bus(setup)
    rehearsal = rehearse(setup, plan, 6)
    assert_orderly(plan, rehearsal.sent)
    table = plan.table
    for node in range(nodes):
        if any(node in row for row in plan.schedule.static_table):
            turns = rehearsal.published[..., node].ravel()
            owned = [any(s.node == node for s in table.static_slots(c)) for c in range(len(turns))]
            assert turns.tolist() == owned, "a static node never starves"


@settings(max_examples=10)
@given(choices)
def test_ages_are_cycles_since_the_sender_last_had_the_bus(options: dict):
    setup = prepared(options)
    trace = read_trace(setup, in_memory(setup))
    rounds = setup.scenario.rounds
    sent = trace.published.reshape(-1, setup.scenario.nodes)
    for step in range(trace.steps):
        now = (step + 1) * rounds - 1
        for node, neighbours in enumerate(setup.neighbours):
            for j in neighbours:
                past = np.flatnonzero(sent[: now + 1, j])
                assert trace.ages[step, node, j] == (now - past[-1] if len(past) else -1)
    figures = figures_of(runs_of_trace(setup, trace))
    assert figures is not None
    pairs = trace.steps * sum(map(len, setup.neighbours))
    assert sum(figures.share_ages) + figures.never_heard == pairs
