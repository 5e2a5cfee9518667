"""A run as arrays: what the messages say, in whatever order they were recorded."""

import tracemalloc
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.dashboard.frames.source import assembled
from concord.dashboard.frames.stage import set_stage
from concord.nodes.changes import Event, Gone
from concord.nodes.messages import Estimate, Measured, Timing, Truth, decode, encode, from_wire
from concord.results.bus.bus_capture import capture, in_order
from concord.results.bus.bus_times import timetable
from concord.results.records.step_rows import StepRows
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.runtime.recording import MESSAGE_BYTES
from concord.scenarios.build import build_bus
from concord.studies.agree import first_difference
from tests.experiments.support import small

SETUPS = {
    "full": small(steps=5),
    "in turns": small(steps=5, schedule="round-robin", occupancy=0.5, rounds=2),
    "contended": small(steps=5, schedule="hybrid", occupancy=0.5),
    "labelled": small(steps=5, rule="labelled"),
    "one node": small(steps=3, nodes=1, graph="complete"),
}
MESSAGES = {name: in_memory(setup) for name, setup in SETUPS.items()}
TRACES = {name: read_trace(SETUPS[name], MESSAGES[name]) for name in SETUPS}


@pytest.mark.parametrize("name", SETUPS)
def test_arrays_hold_what_the_messages_say(name: str):
    setup, trace = SETUPS[name], TRACES[name]
    scenario = setup.scenario
    assert trace.steps == scenario.steps
    assert trace.mean.shape == (scenario.steps, scenario.nodes, 2)
    published = np.zeros_like(trace.published)
    for topic, data in MESSAGES[name]:
        if topic.startswith("share/"):
            step, number = divmod(read_frame(data).cycle, scenario.rounds)
            published[step, number, int(topic.partition("/")[2])] = True
            continue
        match decode(topic, data):
            case Truth() as said:
                np.testing.assert_array_equal(trace.truth[said.step], from_wire(said.state))
            case Measured() as said:
                np.testing.assert_array_equal(
                    trace.readings[said.step, said.node], from_wire(said.readings)
                )
            case Estimate() as said:
                check_estimate(trace, setup.neighbours[said.node], said)
    np.testing.assert_array_equal(trace.published, published)


def check_estimate(trace: Trace, neighbours: list[int], said: Estimate) -> None:
    np.testing.assert_array_equal(trace.mean[said.step, said.node], from_wire(said.mean))
    cov = trace.cov[said.step, said.node]
    np.testing.assert_array_equal(cov[np.triu_indices(2)], from_wire(said.cov))
    np.testing.assert_array_equal(cov, cov.T)
    ages = trace.ages[said.step, said.node]
    assert ages[neighbours].tolist() == said.ages
    assert ages[said.node] == 0
    strangers = sorted(set(range(len(ages))) - {said.node, *neighbours})
    assert (ages[strangers] == -1).all()
    if said.step == trace.steps - 1:
        assert trace.counters[said.node] == said.counters


@pytest.mark.parametrize("name", SETUPS)
@given(st.randoms(use_true_random=False))
@settings(max_examples=20)
def test_the_order_of_messages_does_not_matter(name: str, random):
    shuffled = list(MESSAGES[name])
    random.shuffle(shuffled)
    trace = read_trace(SETUPS[name], shuffled)
    assert first_difference(TRACES[name], trace, "shuffled") is None
    assert trace.counters == TRACES[name].counters


@pytest.mark.parametrize("name", SETUPS)
@given(st.randoms(use_true_random=False), st.floats(0, 1))
@settings(max_examples=40)
def test_a_part_of_the_messages_gives_the_steps_that_are_complete(name: str, random, part: float):
    """A recorder hears each sender over another link: after a crash any message may be missing."""
    messages = list(MESSAGES[name])
    random.shuffle(messages)
    trace = read_trace(SETUPS[name], messages[: round(part * len(messages))])
    whole = TRACES[name]
    for quantity in ("truth", "readings", "mean", "cov", "ages") if trace.steps else ():
        np.testing.assert_array_equal(
            getattr(trace, quantity), getattr(whole, quantity)[: trace.steps]
        )
    assert not (trace.published & ~whole.published[: trace.steps]).any()


def test_messages_after_the_last_complete_step_are_left_out():
    """A node that is ahead has estimated and published more than the others."""
    messages = [
        (topic, data)
        for topic, data in MESSAGES["full"]
        if not (topic == "estimate/2" and decode(topic, data).step >= 3)
    ]
    trace = read_trace(SETUPS["full"], messages)
    assert trace.steps == 3
    assert len(trace.published) == 3
    assert trace.counters[0]["sent"] == 9


def test_in_real_time_a_node_that_falls_behind_cuts_off_no_step_of_the_others():
    late = [one for one in MESSAGES["full"] if not _is_late(*one)]
    timing = ("timing/0", encode(Timing(0, 0, 0.0, [0.0], 0, 0)))
    trace = read_trace(SETUPS["full"], [*late, timing])
    assert trace.steps == 5
    assert np.isnan(trace.mean[2:, 1]).all()
    assert not np.isnan(np.delete(trace.mean, 1, axis=1)).any()
    # Steps at the end in which all nodes were out are those of no node.
    gone = [("event", encode(Event(4, Gone(node)))) for node in range(4)]
    last = [one for one in late if not _is_of_last_step(*one)]
    assert read_trace(SETUPS["full"], [*last, *gone, timing]).steps == 4
    # In lockstep all wait for it.
    assert read_trace(SETUPS["full"], late).steps == 2


def test_in_real_time_steps_that_the_environment_missed_have_no_truth():
    """It stood still for two steps: the nodes went on, and its run did too."""
    kept = [one for one in MESSAGES["full"] if not _is_of_step(*one, ("truth", "measured"), (2, 3))]
    timing = ("timing/0", encode(Timing(0, 0, 0.0, [0.0], 0, 0)))
    trace = read_trace(SETUPS["full"], [*kept, timing])
    assert trace.steps == 5
    assert np.isnan(trace.truth).all(axis=1).tolist() == [False, False, True, True, False]
    assert np.isnan(trace.mean).all(axis=(1, 2)).tolist() == [False, False, True, True, False]


def _is_of_step(topic: str, data: bytes, kinds: tuple[str, ...], steps: tuple[int, ...]) -> bool:
    return topic.partition("/")[0] in kinds and decode(topic, data).step in steps


def _is_of_last_step(topic: str, data: bytes) -> bool:
    return topic.startswith("estimate/") and decode(topic, data).step >= 4


def _is_late(topic: str, data: bytes) -> bool:
    return topic == "estimate/1" and decode(topic, data).step >= 2


@given(
    st.lists(
        st.tuples(
            st.integers(0, 5) | st.integers(0, 1 << 32),
            st.integers(0, 2),
            st.lists(st.none() | st.floats(-1, 1), min_size=1, max_size=3),
        ),
        max_size=60,
    )
)
def test_rows_are_the_last_words_that_fit(told: list[tuple[int, int, list[float | None]]]):
    rows, kept = StepRows(3, {"said": (2,), "number": ()}), {}
    for number, (step, node, said) in enumerate(told):
        assert rows.put(step, node, said=said, number=number) == (len(said) == 2)
        if len(said) == 2:
            kept[step, node] = [*said, number]
    assert len(rows) == len(kept)
    assert rows.steps == max((step + 1 for step, _ in kept), default=0)
    there = np.ones((8, 3), dtype=bool)
    there[2, 1] = False
    places = rows.rows(there)
    for step, node in np.ndindex(8, 3):
        assert ((step, node) in rows) == ((step, node) in kept)
        of_place = kept.get((step, node), [np.nan] * 3) if there[step, node] else [np.nan] * 3
        expected = np.array(of_place, dtype=float)
        np.testing.assert_array_equal(rows.field("said", places)[step, node], expected[:2])
        np.testing.assert_array_equal(rows.field("number", places)[step, node], expected[2])


def test_many_rows_lie_in_several_blocks():
    rows = StepRows(2, {"number": ()})
    for step in range(3000):
        rows.put(step, 1, number=step)
    found = rows.field("number", rows.rows(np.ones((3000, 2), dtype=bool)))
    np.testing.assert_array_equal(found[:, 1], np.arange(3000))
    assert np.isnan(found[:, 0]).all()


def test_estimates_of_another_network_are_none():
    setup, messages = SETUPS["full"], MESSAGES["full"]
    foreign = [
        encode(msgspec.structs.replace(decode(topic, data), **change))
        for topic, data in messages
        if topic == "estimate/1"
        for change in ({"mean": [0.0]}, {"cov": [1.0, 0.0]}, {"ages": [0] * 9})
    ]
    trace = read_trace(setup, [*messages, *(("estimate/1", data) for data in foreign)])
    assert first_difference(TRACES["full"], trace, "foreign") is None


@pytest.mark.parametrize("name", SETUPS)
def test_a_message_that_came_twice_counts_once(name: str):
    setup, once = SETUPS[name], TRACES[name]
    twice = [message for message in MESSAGES[name] for _ in range(2)]
    trace = read_trace(setup, twice)
    assert first_difference(once, trace, "twice") is None
    assert capture(setup, once, MESSAGES[name]) == capture(setup, trace, twice)
    assert (trace.spread is None) == (name != "labelled")
    for told_once, told_twice in zip(once.spread or (), trace.spread or (), strict=True):
        np.testing.assert_array_equal(told_once, told_twice)


def test_reading_takes_little_more_memory_than_the_recording_has_bytes():
    setup = small(steps=300)
    messages = in_memory(setup)
    read_trace(setup, messages)
    tracemalloc.start()
    read_trace(setup, messages)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 2 * sum(MESSAGE_BYTES + len(data) for _, data in messages)


BUSES = {
    **SETUPS,
    "can-fd": small(steps=5, bus="can-fd", schedule="dynamic", occupancy=0.5),
    "plca": small(steps=5, bus="plca"),
}


@pytest.mark.parametrize("name", [name for name in BUSES if name != "one node"])
@pytest.mark.parametrize("shift", [1, 2])
def test_frames_in_the_name_of_another_node_are_read(name: str, shift: int):
    """A recorder hears every sender; such frames may have no slot, or no room in the segment."""
    setup = BUSES[name]
    messages = in_memory(setup)
    for place, (topic, data) in enumerate(messages):
        kind, _, node = topic.partition("/")
        if kind == "share":
            forged = (f"share/{(int(node) + shift) % setup.scenario.nodes}", data)
            messages[place : place + 1] = [(topic, data), forged] if place % 2 else [forged]
        elif kind == "grant":
            words = data[:-1] + b',"classes":[300]}'
            messages[place] = (topic, words if b"classes" not in data else data)
    trace = read_trace(setup, messages)
    assert trace.steps == setup.scenario.steps
    captured = capture(setup, trace, messages)
    bus = build_bus(setup)
    for cycle, row in enumerate(timetable(bus, trace.sent)):
        ends = sorted((frame.start_us, frame.end_us) for frame in row)
        assert all(before[1] <= after[0] for before, after in pairwise(ends)), cycle
        assert not ends or name not in SETUPS or ends[-1][1] <= bus.cycle_us
    assert captured is None or captured == in_order(captured)
    assert len(list(assembled(set_stage(setup), messages))) == trace.steps
