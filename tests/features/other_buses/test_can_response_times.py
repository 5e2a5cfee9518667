"""Worst-case response times on CAN: a published case, and simulated buses under the bounds."""

import heapq
import random
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.features.other_buses.can_fd.response_times import Message, response_times
from tests.bus.support import quick
from tests.pages import ROOT, blocks


def simulated(
    messages: Sequence[Message], phases: Sequence[int], until: int, seed: int
) -> list[int]:
    """The longest response of each message, on a bus that serves the lowest identifier that waits.

    All times are whole; requests come at their earliest and reach the queue after a random jitter.
    """
    drawn = random.Random(seed)
    arrivals = []
    for place, one in enumerate(messages):
        queued = 0
        for event in range(phases[place], until, int(one.period_us)):
            jitter = drawn.choice((0, int(one.jitter_us), drawn.randint(0, int(one.jitter_us))))
            # A queue keeps the order of its requests.
            queued = max(queued, event + jitter)
            arrivals.append((queued, place, event))
    arrivals.sort()
    worst, waiting, now, at = [0] * len(messages), [], 0, 0
    while at < len(arrivals) or waiting:
        if not waiting:
            now = max(now, arrivals[at][0])
        while at < len(arrivals) and arrivals[at][0] <= now:
            _, place, event = arrivals[at]
            heapq.heappush(waiting, (messages[place].identifier, event, place))
            at += 1
        _, event, place = heapq.heappop(waiting)
        now += int(messages[place].time_us)
        worst[place] = max(worst[place], now - event)
    return worst


def test_the_third_message_of_the_published_example_is_worst_in_its_second_instance():
    """Davis et al. 2007, section 3: 1 ms each, periods 2.5, 3.5, 3.5 ms; classical analysis finds
    3 ms for the third, which is wrong: its second instance takes 3.5 ms."""
    times = [Message(1, 1000, 2500), Message(2, 1000, 3500), Message(3, 1000, 3500)]
    found = response_times(times, 8)
    assert [float(one.worst_us or 0) for one in found] == [2000, 3000, 3500]
    assert found[2].instances == 2


sets = st.lists(
    st.tuples(st.integers(20, 120), st.integers(300, 3000), st.integers(0, 400)),
    min_size=2, max_size=6,
)  # fmt: skip


@quick
@given(sets, st.integers(0, 1000))
def test_no_simulated_response_exceeds_its_bound(drawn: list[tuple[int, int, int]], seed: int):
    messages = [Message(place, *times) for place, times in enumerate(drawn)]
    bounds = response_times(messages, 2)
    phases = [random.Random(seed * 10 + place).randrange(0, 200) for place in range(len(messages))]
    # With full jitter at the beginning, instances come as close together as they may.
    for worst, bound in zip(simulated(messages, phases, 60_000, seed), bounds, strict=True):
        assert bound.worst_us is None or worst <= bound.worst_us


def test_the_bound_is_reached_where_all_ask_as_a_lower_frame_begins():
    messages = [Message(1, 100, 900), Message(2, 80, 1000), Message(3, 120, 5000)]
    bounds = response_times(messages, 1)
    worst = [one.worst_us or 0 for one in bounds]
    # Message 3 begins at 0, the others ask one unit of time later.
    seen = simulated(messages, [1, 1, 0], 900, 1)
    assert seen[0] == worst[0] - 1 and seen[1] == worst[1] - 1
    assert bounds[2].worst_us == 300 and bounds[2].blocking_us == 0


def test_messages_that_may_wait_for_ever_have_no_bound():
    full = [Message(1, 60, 100), Message(2, 50, 100)]
    assert [one.worst_us is None for one in response_times(full, 1)] == [False, True]
    exactly = [Message(1, 50, 100), Message(2, 50, 100)]
    assert response_times(exactly, 1)[1].worst_us == 100
    assert response_times([*exactly, Message(3, 10, 1000)], 1)[1].worst_us is None


def test_absurd_messages_are_refused():
    with pytest.raises(ValueError, match="two messages with one identifier"):
        response_times([Message(1, 10, 100), Message(1, 20, 100)], 1)
    with pytest.raises(ValueError, match="message 4 lasts 0 us"):
        response_times([Message(4, 0, 100)], 1)


def test_the_code_of_the_page_runs():
    page = (ROOT / "docs" / "buses.md").read_text(encoding="utf-8")
    (code,) = blocks(page, "python")
    exec(code, {})
