"""One node before anything at all: it never raises, and can always go on."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import read_frame
from concord.filters.fusion.averaging import INFORMATION, MOMENTS, Directly, covariance_intersection
from concord.nodes.messages import (
    CycleClosed,
    Estimate,
    Grant,
    NodeEvent,
    ShareHeard,
)
from concord.nodes.node import (
    NodeConfig,
    Phase,
    initial_state,
    step,
)
from tests.nodes.networks import DECAYED, DROP
from tests.nodes.one_node import (
    PRIORS,
    ROUNDS,
    SCHEDULES,
    STEPS,
    STRANGER,
    clean_events,
    feed,
    heartbeat,
    middle_node,
    share,
)

SMALL = st.integers(0, STEPS * ROUNDS + 1)
NUMBERS = st.floats(allow_nan=True, allow_infinity=True, width=64)
SIZES = st.sampled_from([5e-324, 1e-200, 1e-8, 1.0, 1e8, 1e200, 1.7e308])
# Any numbers at all, and covariances that are positive definite but absurd.
ODD_BODIES = st.one_of(
    st.tuples(*[NUMBERS] * 5),
    st.tuples(SIZES, SIZES, SIZES, st.sampled_from([0.0, 1e-9, 1e-162]), SIZES),
    st.tuples(SIZES.map(lambda size: -size), SIZES, SIZES, st.just(0.0), SIZES),
).map(lambda values: np.array(values).tobytes())


@st.composite
def any_events(draw: st.DrawFn, config: NodeConfig) -> list[NodeEvent]:
    """Anything that a network can deliver to a node, sound or not, in any order."""
    sound = st.builds(
        lambda sender, cycle, belief: ShareHeard(sender, share(config, sender, cycle, belief)),
        st.sampled_from([0, 2]),
        SMALL,
        st.sampled_from(PRIORS),
    )
    # Right checksums around anything, in anybody's slot.
    odd = st.builds(
        lambda sender, owner, cycle, body: ShareHeard(
            sender, config.bus.encode(owner, cycle, body)[0]
        ),
        st.sampled_from([0, 1, 2, STRANGER]),
        st.sampled_from([0, 1, 2]),
        st.one_of(SMALL, st.integers(0, 2**32 - 1)),
        ODD_BODIES,
    )
    garbage = st.builds(ShareHeard, st.sampled_from([0, 2, -1]), st.binary(max_size=60))
    measured = SMALL.map(heartbeat)
    grants = st.builds(Grant, SMALL, st.lists(st.integers(0, 2), unique=True))
    closed = SMALL.map(CycleClosed)
    return draw(st.lists(st.one_of(sound, odd, garbage, measured, grants, closed), max_size=30))


@given(st.data(), st.sampled_from(sorted(SCHEDULES)), st.booleans())
@settings(max_examples=60)
def test_a_node_survives_any_events(data: st.DataObject, name: str, held: bool):
    config = middle_node(SCHEDULES[name], hold_policy=DECAYED if held else DROP)
    events = data.draw(any_events(config))
    state = initial_state(config)
    seen = 0
    # Numbers beyond all bounds overflow; a node that survives them need not be silent about it.
    with np.errstate(all="ignore"):
        for event in events:
            after, messages = step(config, state, event)
            assert after.cycle >= state.cycle
            assert all(after.counters.get(k, 0) >= n for k, n in state.counters.items())
            for message in messages:
                if isinstance(message, Estimate):
                    assert message.step == seen
                    assert None not in message.mean + message.cov
                    seen += 1
            state = after
        # It can always go on: with its heartbeats, and the end of every cycle, it finishes.
        for number in range(STEPS):
            state, _ = step(config, state, heartbeat(number))
            for cycle in range(STEPS * ROUNDS):
                state, _ = step(config, state, CycleClosed(cycle))
    assert state.phase is Phase.FINISHED
    assert len(state.inbox.parts) + len(state.inbox.shares) + len(state.inbox.grants) <= len(events)


ABSURD = [-1.7e308, 1e-200, 1e8, 1.7e308]


@pytest.mark.parametrize("hold", [DECAYED, DROP], ids=["decayed", "drop"])
@pytest.mark.parametrize("average", [INFORMATION, MOMENTS, Directly(covariance_intersection)])
@pytest.mark.parametrize("name", ["full", "dynamic"])
def test_absurd_beliefs_with_right_checksums_stop_nobody(name: str, average, hold):
    """A peer that has lost its mind: any size of mean and variances, in the right slot and time."""
    config = middle_node(SCHEDULES[name], average, hold)
    events = clean_events(config)
    places = [i for i, e in enumerate(events) if isinstance(e, ShareHeard)][:2]
    for mean, *variances in product(ABSURD, ABSURD[1:], ABSURD[1:]):
        body = np.array([mean, -mean, variances[0], 0.0, variances[1]]).tobytes()
        for place in places:
            sender, cycle = events[place].sender, read_frame(events[place].frame).cycle  # type: ignore[union-attr]
            frame = config.bus.encode(sender, cycle, body)[0]
            events[place] = ShareHeard(sender, frame)
        with np.errstate(all="ignore"):
            state, sent = feed(config, events)
        assert state.phase is Phase.FINISHED
        assert all(None not in m.mean + m.cov for m in sent if isinstance(m, Estimate))


@given(st.data())
@settings(max_examples=25)
def test_the_same_events_give_the_same_messages(data: st.DataObject):
    """No memory but the state: stepping is a function, and states are values that stay."""
    config = middle_node()
    events = data.draw(any_events(config))
    with np.errstate(all="ignore"):
        states = [initial_state(config)]
        sent = []
        for event in events:
            state, messages = step(config, states[-1], event)
            states.append(state)
            sent.append(messages)
        for before, event, after, messages in zip(states, events, states[1:], sent, strict=False):
            again, repeated = step(config, before, event)
            assert repeated == messages
            assert (again.phase, again.step, again.cycle) == (after.phase, after.step, after.cycle)
            assert again.counters == after.counters
