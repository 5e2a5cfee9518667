"""The short way that a frame which is due takes comes to the same as the long way of all others."""

from collections.abc import Sequence
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.nodes import node as state_machine
from concord.nodes.messages import NodeEvent, ShareHeard
from concord.nodes.node import NodeConfig, initial_state, step
from concord.nodes.node_state import NodeState
from tests.nodes.one_node import (
    ROUNDS,
    SCHEDULES,
    STEPS,
    STRANGER,
    clean_events,
    feed,
    middle_node,
    share,
)

pytestmark = pytest.mark.slow

SENDERS = st.sampled_from([0, 2, STRANGER])


def in_words(state: NodeState) -> tuple:
    """Return the content of a state, with arrays as bytes."""
    inbox, content = state.inbox, state.content
    own, held = content.own, content.held
    beliefs = own.belief, held.beliefs, own.published.belief
    told = [part.tobytes() for belief in beliefs for part in belief], held.ages.tolist()
    waits = inbox.measured, inbox.grants, inbox.parts, inbox.early, inbox.overtaken, inbox.late
    return (
        state.phase,
        state.step,
        state.cycle,
        state.group,
        state.counters,
        inbox.shares,
        told,
        waits,
    )


def in_sum(state: NodeState) -> tuple:
    """Return what a state believes and how many events it counted.

    A repeat is counted as late or as repeated, whichever it is when its batch is taken.
    """
    phase, number, cycle, _, counters, shares, told, _ = in_words(state)
    kinds = ("heard", "missed", "sent")
    return (
        phase,
        number,
        cycle,
        shares,
        told,
        [counters.get(k) for k in kinds],
        sum(counters.values()),
    )


def the_long_way(config: NodeConfig, events: Sequence[NodeEvent]) -> NodeState:
    with mock.patch.object(
        state_machine, "take_due", lambda config, state, events: (state, events)
    ):
        return feed(config, events)[0]


@st.composite
def frames(draw: st.DrawFn, config: NodeConfig) -> ShareHeard:
    """One of a neighbour, of any cycle, that may come on another's channel and be altered."""
    channel, owner = draw(SENDERS), draw(st.sampled_from([0, 2]))
    frame = share(config, owner, draw(st.integers(0, STEPS * ROUNDS)))
    for place in draw(st.lists(st.integers(0, 8 * len(frame) - 1), max_size=2)):
        bits = bytearray(frame)
        bits[place // 8] ^= 1 << place % 8
        frame = bytes(bits)
    return ShareHeard(channel, frame + draw(st.sampled_from([b"", b"", b"\0", b"\0\0"])))


@pytest.mark.parametrize("name", SCHEDULES)
@given(st.data())
def test_a_frame_that_is_due_means_what_it_means_the_long_way(name: str, data: st.DataObject):
    config = middle_node(SCHEDULES[name])
    events = clean_events(config)
    for frame in data.draw(st.lists(frames(config), max_size=6)):
        events.insert(data.draw(st.integers(0, len(events))), frame)
    events = events[: data.draw(st.integers(0, len(events)))]
    assert in_words(feed(config, events)[0]) == in_words(the_long_way(config, events))


def test_whatever_its_bits_and_length_a_frame_in_another_form_is_judged_the_long_way():
    """Each bit of a sound frame in turn: none is let in, and each is counted alike."""
    config = middle_node()
    opened, sound = clean_events(config)[:2]
    assert isinstance(sound, ShareHeard)
    assert feed(config, [opened, sound])[0].counters == {"sent": 1, "heard": 1}
    for place in range(8 * len(sound.frame)):
        bits = bytearray(sound.frame)
        bits[place // 8] ^= 1 << place % 8
        events = [opened, ShareHeard(sound.sender, bytes(bits))]
        state = feed(config, events)[0]
        assert "heard" not in state.counters
        assert in_words(state) == in_words(the_long_way(config, events))


@given(st.data())
def test_frames_that_come_together_mean_what_they_mean_one_after_the_other(data: st.DataObject):
    """A node in lockstep takes one of each neighbour that is missing at a time."""
    config = middle_node()
    together = one_by_one = initial_state(config)
    for event in clean_events(config):
        if not isinstance(event, ShareHeard):
            together, _ = step(config, together, event)
            one_by_one, _ = step(config, one_by_one, event)
            continue
        if event.sender != 0:
            continue
        cycle = one_by_one.cycle
        heard = [ShareHeard(j, share(config, j, cycle)) for j in (0, 2)]
        if data.draw(st.booleans()):
            # One of the two is of no use, and another one of its sender follows.
            broken = ShareHeard(2, heard[1].frame[:-1] + b"?")
            together, _ = step(config, together, heard[0], broken)
            one_by_one, _ = step(config, step(config, one_by_one, heard[0])[0], broken)
            heard = heard[1:]
        together, _ = step(config, together, *heard)
        for one in heard:
            one_by_one, _ = step(config, one_by_one, one)
        assert in_words(together) == in_words(one_by_one)
    assert together.step == STEPS - 1
    np.testing.assert_array_equal(
        together.content.own.belief.mean, one_by_one.content.own.belief.mean
    )


@pytest.mark.parametrize("name", SCHEDULES)
@given(st.data())
def test_events_that_come_together_mean_the_same_as_one_by_one(name: str, data: st.DataObject):
    """Batches of frames, with repeats among them: a frame twice in a batch is used once."""
    config = middle_node(SCHEDULES[name])
    events = clean_events(config)
    for _ in range(data.draw(st.integers(0, 4))):
        place = data.draw(st.integers(0, len(events) - 1))
        events.insert(place, events[place])
    for frame in data.draw(st.lists(frames(config), max_size=3)):
        events.insert(data.draw(st.integers(0, len(events))), frame)
    state, left = initial_state(config), events
    while left:
        size = data.draw(st.integers(1, 5))
        state, _ = step(config, state, *left[:size])
        left = left[size:]
    assert in_sum(state) == in_sum(feed(config, events)[0])
