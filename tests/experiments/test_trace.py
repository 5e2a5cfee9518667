"""A run as arrays: what the messages say, in whatever order they were recorded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.nodes.changes import Event, Gone
from concord.nodes.messages import Estimate, Measured, Timing, Truth, decode, encode, from_wire
from concord.results.records.trace import Trace, read_trace
from concord.runtime.drivers import in_memory
from concord.studies.agree import first_difference
from tests.experiments.support import small

SETUPS = {
    "full": small(steps=5),
    "in turns": small(steps=5, schedule="round-robin", occupancy=0.5, rounds=2),
    "contended": small(steps=5, schedule="hybrid", occupancy=0.5),
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
