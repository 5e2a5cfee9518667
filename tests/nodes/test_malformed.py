"""Malformed frames and messages: all counted, nothing changed."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from concord.bus.flexray.share_frames import SHARE_FRAMES, in_slot
from concord.bus.schedule import hybrid
from concord.nodes.bounds import MAX_FRAME_BYTES, MAX_MESSAGE_BYTES
from concord.nodes.changes import Set
from concord.nodes.inbox import EARLY_CYCLES, EARLY_STEPS, MOST_EARLY
from concord.nodes.messages import (
    Bid,
    Estimate,
    Grant,
    MalformedMessage,
    Measured,
    ShareHeard,
    decode,
    encode,
)
from concord.nodes.node import NodeConfig, Phase, initial_state, step
from concord.nodes.node_changes import apply
from concord.runtime.recording import McapRecorder, read_recording
from concord.scenarios.build import build_node
from concord.scenarios.catalogue import definition_named
from concord.scenarios.preparation import prepare
from tests.nodes.one_node import (
    ROUNDS,
    STEPS,
    STRANGER,
    clean_events,
    estimates,
    feed,
    heartbeat,
    middle_node,
    share,
)

FLIPS = 5
TOPICS = {
    "measured/1": encode(Measured(1, 2, [[1.0, None]], [0.5])),
    "bid/1": encode(Bid(1, 3, 7, 24)),
    "estimate/1": encode(Estimate(1, 2, [1.0], [2.0], [0], {"missed": 1})),
}
# Whole JSON that is no message: wrong types, out of range, of somebody else, or absurd.
WRONG_JSON = [
    ("bid/1", {"node": 2, "cycle": 3, "bid": 1, "payload_bytes": 24}),
    ("bid/1", {"node": -1, "cycle": 3, "bid": 1, "payload_bytes": 24}),
    ("bid/1", {"node": 1, "cycle": -3, "bid": 1, "payload_bytes": 24}),
    ("bid/1", {"node": 1, "cycle": 1 << 32, "bid": 1, "payload_bytes": 24}),
    ("bid/1", {"node": 1, "cycle": 3, "bid": "much", "payload_bytes": 24}),
    ("bid/1", {"node": 1, "cycle": 3, "bid": 1, "payload_bytes": -24}),
    ("gone", {"what": "gone", "node": -1}),
    ("gone", {"what": "gone", "node": 1 << 16}),
    ("gone/1", {"what": "gone", "node": 1 << 40}),
    ("grant", {"cycle": 1, "winners": [-1]}),
    ("grant", {"cycle": 1, "winners": [1.5]}),
    ("grant", {"cycle": 1, "winners": [0], "group": -1}),
    ("measured/1", {"node": 3, "step": 0, "readings": []}),
    ("measured/1", {"node": 1, "step": -1, "readings": []}),
    ("measured/1", {"node": 1, "step": 0, "readings": [1.0]}),
    ("measured/1", {"node": 1, "step": 0, "readings": [[1.0], [1.0, 2.0]]}),
    ("measured/1", {"node": 1, "step": 0, "readings": [["a"]]}),
    ("estimate/1", {"node": 1, "step": 0}),
    ("estimate/1", []),
    ("estimate/1", None),
    ("share/1", {}),
    ("", {}),
]


def malformed_frames(config: NodeConfig, seed: int, count: int) -> Iterator[ShareHeard]:
    """Frames that no sound neighbour sends at any time of a run, by kind in turn."""
    rng = np.random.default_rng(seed)
    sound = [share(config, j, cycle) for j in (0, 2) for cycle in range(STEPS * ROUNDS)]
    far = STEPS * ROUNDS + max(EARLY_STEPS * ROUNDS, EARLY_CYCLES) + 1
    future = [config.bus.encode(0, far + more, sound[0][9:40])[0] for more in (0, 1, 999, 2**31)]
    sizes = rng.integers(0, MAX_FRAME_BYTES + 8, count).tolist()
    picks = rng.integers(0, len(sound), count).tolist()
    for number, (size, pick) in enumerate(zip(sizes, picks, strict=True)):
        sender, frame = (0, 2)[pick % 2], sound[pick]
        match number % 6:
            case 0:
                frame = rng.bytes(size)
            case 1:
                frame = frame[: size % len(frame)]
            case 2:
                frame = frame + rng.bytes(1 + size % 9)
            case 3:
                damaged = bytearray(frame)
                for place in set(rng.bytes(FLIPS)):
                    damaged[place % len(frame)] ^= 1 << (place % 8)
                frame = bytes(damaged) if bytes(damaged) != frame else b""
            case 4:
                sender = (STRANGER, 1, -1)[size % 3]
            case _:
                frame = future[pick % len(future)]
        yield ShareHeard(sender, frame)


def storm(count: int, seed: int) -> tuple[int, bool]:
    """A run with `count` malformed frames in between: how many were counted, and whether the
    estimates are those of a run without."""
    config = middle_node()
    clean = clean_events(config)
    _, undisturbed = feed(config, clean)
    flood = malformed_frames(config, seed, count)
    state, sent = initial_state(config), []
    for number, event in enumerate(clean):
        share_of = count * (number + 1) // len(clean) - count * number // len(clean)
        for _ in range(share_of):
            state, messages = step(config, state, next(flood))
            assert not messages
        state, messages = step(config, state, event)
        sent += messages
    assert state.phase is Phase.FINISHED
    counted = sum(n for name, n in state.counters.items() if name.startswith("rejected"))
    assert len(state.inbox.shares) + len(state.inbox.parts) == 0
    return counted, estimates(sent) == estimates(undisturbed)


def test_malformed_frames_are_counted_and_change_nothing():
    assert storm(3000, 1) == (3000, True)


def test_what_is_kept_for_later_is_bounded():
    """Well-formed heartbeats, grants and frames of steps that no node has begun."""
    config = middle_node(hybrid(3, 0.7))
    state, _ = step(config, initial_state(config), heartbeat(0))
    for number in range(1, 2 * MOST_EARLY):
        state, _ = step(config, state, Measured(1, number, [[None, None]]))
        state, _ = step(config, state, Grant(1 + number % EARLY_CYCLES, [0], number))
    assert len(state.inbox.measured) <= EARLY_CYCLES
    assert len(state.inbox.grants) <= MOST_EARLY
    kept = len(state.inbox.measured) + len(state.inbox.grants)
    assert kept + state.counters["rejected future"] == 2 * (2 * MOST_EARLY - 1)


def test_early_frames_in_slots_of_nobody_are_not_kept():
    config = middle_node()
    begun, _ = step(config, initial_state(config), heartbeat(0))
    ahead = [in_slot(share(config, 0, ROUNDS), frame_id) for frame_id in range(4, 2000)]
    for state in (begun, initial_state(config)):
        for frame in ahead:
            state, _ = step(config, state, ShareHeard(0, frame))
        if state.phase is Phase.MEASUREMENT:
            # Between two steps a node does not know the next slots; from the next step on it does.
            state, _ = step(config, state, heartbeat(0))
        assert state.inbox.early == {}
        assert state.counters["rejected wrong-slot"] == len(ahead)


@pytest.mark.parametrize(("topic", "value"), WRONG_JSON)
def test_wrong_json_is_named(topic: str, value: object):
    with pytest.raises(MalformedMessage, match=repr(topic)):
        decode(topic, msgspec.json.encode(value))


def test_what_is_too_long_is_not_even_read():
    padded = TOPICS["bid/1"] + b" " * MAX_MESSAGE_BYTES
    with pytest.raises(MalformedMessage, match="at most"):
        decode("bid/1", padded)
    assert decode("bid/1", TOPICS["bid/1"] + b" " * 100).bid == 7
    with pytest.raises(MalformedMessage):
        decode("bid/1", b"[" * (MAX_MESSAGE_BYTES - 1))


@given(st.sampled_from(sorted(TOPICS)), st.binary(max_size=40) | st.just(b'{"step":1e30}'))
def test_any_bytes_can_be_recorded(topic: str, data: bytes):
    """The recorder keeps a stranger's message unchanged, and the message after it too."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        recorder = McapRecorder(path, 2, 0.1, SHARE_FRAMES)
        recorder.record([(topic, data)])
        recorder.record([("bid/1", TOPICS["bid/1"])])
        recorder.close()
        assert list(read_recording(path)) == [(topic, data), ("bid/1", TOPICS["bid/1"])]


MISFITS = [
    {"readings": [[1.0, 2.0, 3.0, 4.0, 5.0]]},
    {"readings": []},
    {"readings": [[1.0], [1.0]]},
    {"readings": [[]]},
]


@pytest.mark.parametrize("misfit", MISFITS)
def test_a_heartbeat_of_another_form_is_refused(misfit: dict):
    """A node learns the form of its readings from its first heartbeat. The true one comes later."""
    config = middle_node()
    clean = clean_events(config)
    _, undisturbed = feed(config, clean)
    first = next(event for event in clean if isinstance(event, Measured))
    wrong = Measured(first.node, first.step + 1, **misfit)
    place = clean.index(first) + 1
    state, sent = feed(config, [*clean[:place], wrong, *clean[place:]])
    assert state.counters["rejected readings"] == 1
    assert estimates(sent) == estimates(undisturbed)


@pytest.mark.parametrize("settings", [{"rule": "nonsense"}, {"rounds": "x"}, {"steps": 3}])
def test_settings_that_cannot_be_are_refused(settings: dict):
    setup = prepare(definition_named("oscillator").defaults.with_(nodes=2, graph="path"))
    config = build_node(setup, 0)
    heartbeat_ = Measured(0, 0, [[1.0]], changes=(Set(settings, 7),))
    state, _ = step(config, initial_state(config), heartbeat_)
    after, state, _ = apply(config, state)
    assert state.counters["rejected change"] == 1
    assert (after.rounds, after.first_cycle, after.standing) == (config.rounds, 0, config.standing)
    assert state.phase is not Phase.CHANGE
