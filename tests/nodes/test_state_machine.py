"""One node before whatever may come: it never raises, counts what it refuses, keeps its head."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.publication import Slot
from concord.bus.flexray.share_frames import to_frames
from concord.bus.schedule import Schedule, dynamic_only, round_robin
from concord.nodes.faults.losses import LinkState, hears
from concord.nodes.messages import (
    Bid,
    CycleClosed,
    Estimate,
    Grant,
    NodeEvent,
    ShareHeard,
    ShareSent,
    encode,
)
from concord.nodes.node import (
    NodeConfig,
    Phase,
    awaited_neighbours,
    initial_state,
    step,
)
from concord.nodes.vector_codec import BeliefCodec
from tests.nodes.networks import with_slots
from tests.nodes.one_node import (
    PRIORS,
    SCHEDULES,
    STEPS,
    STRANGER,
    clean_events,
    estimates,
    feed,
    heartbeat,
    middle_node,
    share,
)


def test_the_bytes_of_an_estimate_keep_no_order_of_arrival():
    """A node that joins late may hear before it sends, or send before it hears."""
    config = middle_node()
    begun, *others = clean_events(config)
    first, last = (
        feed(config, events)[1] for events in ([begun, *others], [others[0], begun, *others[1:]])
    )
    said = [[encode(m) for m in sent if isinstance(m, Estimate)] for sent in (first, last)]
    assert said[0] == said[1] and len(said[0]) == STEPS


@pytest.mark.parametrize("name", SCHEDULES)
def test_a_clean_run_ends_with_an_estimate_of_every_step(name: str):
    config = middle_node(SCHEDULES[name])
    state, sent = feed(config, clean_events(config))
    assert state.phase is Phase.FINISHED
    assert [m.step for m in sent if isinstance(m, Estimate)] == list(range(STEPS))
    assert set(state.counters) <= {"sent", "heard"}


def test_the_order_of_messages_in_a_step():
    """A contender bids, is granted, sends; in the next cycle again; then it says its estimate."""
    config = middle_node(dynamic_only(3, 0.7))
    _, sent = feed(config, clean_events(config)[:5])
    assert [type(m) for m in sent] == [Bid, ShareSent, Bid, ShareSent, Estimate]
    assert [m.cycle for m in sent if isinstance(m, Bid | ShareSent)] == [0, 0, 1, 1]


def test_a_node_waits_for_exactly_those_who_are_due():
    """Turns of one: node 0 sends in cycle 0, node 1 itself in cycle 1, node 2 in cycle 2."""
    config = middle_node(round_robin(3, 1))
    state, sent = feed(config, [heartbeat(0)])
    assert (state.phase, awaited_neighbours(config, state)[0]) == (Phase.SHARES, 0)
    assert sent == []
    state, sent = step(config, state, ShareHeard(0, share(config, 0, 0)))
    assert [type(m) for m in sent] == [ShareSent, Estimate]
    assert state.phase is Phase.MEASUREMENT
    state, sent = step(config, state, heartbeat(1))
    assert (state.cycle, awaited_neighbours(config, state)[0]) == (2, 2)


@given(st.sampled_from(sorted(SCHEDULES)), st.randoms(use_true_random=False))
@settings(max_examples=40)
def test_any_order_of_events_gives_the_same_estimates(name: str, random):
    config = middle_node(SCHEDULES[name])
    events = clean_events(config)
    state, expected = feed(config, events)
    random.shuffle(events)
    shuffled_state, sent = feed(config, events)
    assert estimates(sent) == estimates(expected)
    assert shuffled_state.counters == state.counters


# --- what is no use ------------------------------------------------------------------------------


def _nuisances(config: NodeConfig, cycle: int) -> dict[str, NodeEvent]:
    """Each kind of useless event while `cycle` is open, by the counter that it must raise."""
    sound = share(config, 0, cycle)
    body = BeliefCodec(2).encode(PRIORS[0])
    wrong_slot = config.bus.encode(2, cycle, body)[0]
    flipped = bytes([*sound[:-1], sound[-1] ^ 1])
    miscounted = config.bus.frame_format.miscounted(config.bus.encode(0, cycle + 8, body)[0], 8)
    kinds: dict[str, NodeEvent] = {
        "rejected stranger": ShareHeard(STRANGER, sound),
        "rejected too-short": ShareHeard(0, b"\x00\x01"),
        "rejected frame-crc": ShareHeard(0, flipped),
        "rejected header-crc": ShareHeard(0, bytes([sound[0] ^ 1, *sound[1:]])),
        "rejected wrong-slot": ShareHeard(0, wrong_slot),
        "rejected cycle-count": ShareHeard(0, miscounted),
        "rejected future": ShareHeard(0, share(config, 0, 3_000_000_000)),
        "repeated measured": heartbeat(0),
    }
    if cycle:
        kinds["late"] = ShareHeard(0, share(config, 0, cycle - 1))
    return kinds


def _open_at(config: NodeConfig, cycle: int) -> int:
    """How many of the clean events come before the last that closes `cycle`."""
    state = initial_state(config)
    for place, event in enumerate(clean_events(config)):
        state, _ = step(config, state, event)
        if state.cycle > cycle:
            return place
    raise AssertionError("the clean run does not reach that cycle")


@pytest.mark.parametrize("cycle", [0, 2, 3])
def test_each_useless_event_is_counted_by_name_and_changes_nothing(cycle: int):
    config = middle_node()
    events = clean_events(config)
    _, expected = feed(config, events)
    place = _open_at(config, cycle)
    for name, nuisance in _nuisances(config, cycle).items():
        state, sent = feed(config, [*events[:place], nuisance, *events[place:]])
        assert state.counters.get(name) == 1, name
        assert estimates(sent) == estimates(expected), name


def test_a_share_that_was_not_scheduled_is_not_used():
    config = middle_node(round_robin(3, 1))
    events = clean_events(config)
    _, expected = feed(config, events)
    # Cycle 2 belongs to node 2.
    intruder = ShareHeard(0, share(config, 0, 2))
    place = _open_at(config, 2)
    state, sent = feed(config, [*events[:place], intruder, *events[place:]])
    assert state.counters["rejected unscheduled"] == 1
    assert estimates(sent) == estimates(expected)


def test_a_share_is_used_once():
    """Of two shares of one sender in one cycle the first counts, whatever the second says."""
    config = middle_node()
    events = clean_events(config)
    _, expected = feed(config, events)
    other = ShareHeard(0, share(config, 0, 0, PRIORS[2]))
    state, sent = feed(config, [*events[:2], other, *events[2:]])
    assert state.counters["repeated"] == 1
    assert estimates(sent) == estimates(expected)


def test_a_closed_cycle_goes_on_with_what_has_come():
    config = middle_node()
    state, _ = feed(config, [heartbeat(0), ShareHeard(2, share(config, 2, 0))])
    assert awaited_neighbours(config, state)[0] == 0
    state, sent = step(config, state, CycleClosed(0))
    assert state.counters["missed"] == 1
    assert state.cycle == 1
    # The end of a cycle that is over, or not begun, says nothing.
    for cycle in (0, 2):
        unmoved, sent = step(config, state, CycleClosed(cycle))
        assert (unmoved.cycle, sent) == (1, [])


def test_without_a_grant_what_a_contender_sent_still_counts():
    """Node 2 contends, wins and sends, but the environment's grant reaches this node too late."""
    config = middle_node(Schedule(3, ((0, 1),), ((2,),), (1,)))
    came = [heartbeat(0), *(ShareHeard(j, share(config, j, 0)) for j in (0, 2))]
    state, _ = feed(config, came)
    assert state.phase is Phase.GRANT
    closed, _ = step(config, state, CycleClosed(0))
    granted, _ = step(config, state, Grant(0, [2]))
    assert closed.cycle == granted.cycle == 1
    np.testing.assert_array_equal(closed.content.own.belief.mean, granted.content.own.belief.mean)
    late, _ = step(config, closed, Grant(0, [2]))
    assert late.counters["repeated grant"] == 1


def test_a_share_is_lost_with_any_of_its_frames_and_nobody_waits_for_the_rest():
    """Shares of three frames, of which the link loses some: counted one by one, used whole or not
    at all, in whatever order they come."""
    plain = with_slots(middle_node(), three_slots)
    for key in range(40):
        config = replace(plain, links=LinkState((key, 0), 0.3))
        frames = to_frames(BeliefCodec(2).encode(PRIORS[0]), 0, three_slots(0, 0)[0])
        assert len(frames) == 3
        arrive = [hears(config.links, 0, 0, 0, 1, number) for number in range(3)]
        outcomes = []
        for order in permutations(frames):
            state, _ = feed(config, [heartbeat(0), *(ShareHeard(0, frame) for frame in order)])
            assert awaited_neighbours(config, state)[0] == 2
            outcomes.append(state.counters)
        sent = {"sent": 3}
        lost = {"lost": arrive.count(False)} if not all(arrive) else {}
        heard = {"heard": 1} if all(arrive) else {}
        assert all(counters == sent | lost | heard for counters in outcomes)


def three_slots(node: int, cycle: int) -> tuple[tuple[Slot, ...], ...]:
    return (tuple(Slot(3 * node + part + 1, 24) for part in range(3)),)
